//! FBX read by an independent reader (`ufbx`), which also evaluates its animation.

use bailando_formats::{TargetSkeleton, to_fbx};
use bailando_motion::{Positions, forward};
use bailando_testkit::motion::distances;

use crate::{motion, recorded};

/// Largest distance from forward kinematics, metres.
const TOLERANCE: f64 = 1e-3;

#[test]
fn an_independent_reader_sees_our_positions_take_and_time() {
    let mut motions = vec![("untrained".to_owned(), motion(20)), ("untrained".into(), motion(24))];
    motions.extend(recorded(30).into_iter().take(1));
    for (name, motion) in motions {
        for target in TargetSkeleton::ALL {
            let file = to_fbx(&motion, target).unwrap();
            let scene = ufbx::load_memory(&file, ufbx::LoadOpts::default()).unwrap();
            assert_eq!(scene.metadata.version, 7400);
            assert!(scene.metadata.warnings.is_empty(), "{:?}", scene.metadata.warnings.len());
            let stack = &scene.anim_stacks[0];
            assert_eq!(&*stack.element.name, "Dance");
            let fps = f64::from(motion.animation.fps);
            assert_eq!(scene.settings.frames_per_second, fps);
            let frames = motion.animation.root.len();
            assert!((stack.time_end - (frames - 1) as f64 / fps).abs() < 1e-6);
            assert_eq!(scene.settings.unit_meters, 0.01);

            let expected = forward(&motion.skeleton, &motion.animation).unwrap();
            let mut positions = Positions::zeros(expected.dim());
            // The scene's root, then Unreal's, come before the joints.
            let first = scene.nodes.len() - motion.skeleton.joints.len();
            for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
                let time = frame as f64 / fps;
                let options = ufbx::EvaluateOpts::default();
                let scene = ufbx::evaluate_scene(&scene, &stack.anim, time, options).unwrap();
                for (place, mut joint) in pose.outer_iter_mut().enumerate() {
                    let node = scene
                        .nodes
                        .iter()
                        .find(|node| node.element.typed_id as usize == first + place);
                    let origin = node.unwrap().node_to_world;
                    let metres = [origin.m03, origin.m13, origin.m23].map(|v| (v / 100.0) as f32);
                    joint.assign(&ndarray::arr1(&metres));
                }
            }
            let (_, largest) = distances(&positions, &expected);
            println!("ufbx, {name}, {}: {largest:.2e} m", target.name());
            assert!(largest < TOLERANCE, "{name}, {target:?}: {largest} m");
        }
    }
}
