//! The motion chain: kinematics on the skeleton, and finished motions against golden vectors and
//! recordings.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test says what is wrong by failing"
)]

mod clean;
mod finish;
mod kinematics;

use bailando_motion::{Animation, Positions, forward};
use bailando_testkit::motion::{distances, skeleton};
use glam::{Quat, Vec3};

/// A lively motion: every joint swings about its own axis with its own period.
fn swinging(frames: usize, fps: u32) -> Animation {
    let angle = |joint: usize, frame: usize| {
        let seconds = frame as f32 / fps as f32;
        0.9 * (seconds * (2.0 + joint as f32 * 0.3) + joint as f32).sin()
    };
    let axis = |joint: usize| {
        let j = joint as f32;
        Vec3::new((j * 1.7).sin(), (j * 2.3).cos(), (j * 0.9).sin() + 0.2).normalize()
    };
    let rotation = |frame, joint| Quat::from_axis_angle(axis(joint), angle(joint, frame));
    Animation {
        fps,
        root: (0..frames).map(|f| Vec3::new(0.01 * f as f32, 0.9, -0.3)).collect(),
        rotations: (0..frames)
            .map(|frame| (0..24).map(|joint| rotation(frame, joint)).collect())
            .collect(),
    }
}

/// The rest pose with its root turned, for so many frames.
fn still(frames: usize, root: Quat) -> Animation {
    let mut pose = vec![Quat::IDENTITY; 24];
    pose[0] = root;
    Animation { fps: 60, root: vec![Vec3::ZERO; frames], rotations: vec![pose; frames] }
}

fn posed(animation: &Animation) -> Positions {
    forward(&skeleton(), animation).unwrap()
}

/// Asserts that no joint of `a` is further from that of `b`, metres.
fn assert_near(a: &Positions, b: &Positions, tolerance: f64) {
    let (_, largest) = distances(a, b);
    assert!(largest < tolerance, "{largest} m");
}

fn assert_continuous_unit_quaternions(animation: &Animation) {
    for pose in &animation.rotations {
        assert!(pose.iter().all(|q| (q.length() - 1.0).abs() < 1e-5));
    }
    for pair in animation.rotations.windows(2) {
        assert!(pair[0].iter().zip(&pair[1]).all(|(a, b)| a.dot(*b) >= 0.0));
    }
}
