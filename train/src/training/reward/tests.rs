use super::*;

fn rule(beat: BeatReward, beat_weight: f64, consistency_weight: f64) -> RewardRule {
    RewardRule { beat, beat_weight, consistency_weight, slow_weight: 0.0, speed_weight: 0.0 }
}

/// An upright body, turned about y; the lower half turned further.
fn pose(heading: f64, twist: f64) -> Pose {
    let turned = |x: f64, y: f64, z: f64, angle: f64| {
        let (sin, cos) = angle.sin_cos();
        DVec3::new(cos * x + sin * z, y, cos * z - sin * x)
    };
    std::array::from_fn(|joint| {
        let place = match joint {
            LEFT_KNEE => turned(0.1, -0.4, 0.05, heading + twist),
            RIGHT_KNEE => turned(-0.1, -0.4, 0.02, heading + twist),
            LEFT_COLLAR => turned(0.08, 0.4, 0.01, heading),
            RIGHT_COLLAR => turned(-0.07, 0.41, 0.0, heading),
            12 => turned(0.0, 0.5, 0.0, heading),
            15 => turned(0.0, 0.6, 0.08, heading),
            _ => DVec3::ZERO,
        };
        place + DVec3::new(3.0, 0.9, -2.0)
    })
}

/// ARCHITECTURE section 6, word by word.
fn by_the_word(pose: &Pose) -> f64 {
    let p = |joint: usize| pose[joint] - pose[0];
    let u = p(14).cross(p(13)).normalize();
    let l = p(4).cross(p(5)).normalize();
    let sign = u.dot(p(15) - p(12)).signum();
    let flat = |v: DVec3| DVec3::new(sign * v.x, 0.0, sign * v.z);
    flat(u).dot(flat(l))
}

#[test]
fn heading_is_as_defined() {
    for heading in [0.0, 1.0, 4.0] {
        for twist in [0.0, 0.8, 2.0, 3.1] {
            let pose = pose(heading, twist);
            let found = heading_product(&pose);
            assert!((found - by_the_word(&pose)).abs() < 1e-12);
            // Nearly upright: the cosine of the twist.
            assert!((found - twist.cos()).abs() < 0.1, "{found} {twist}");
        }
    }
    assert_eq!(heading_product(&[DVec3::ONE; 24]), 0.0);
}

#[test]
fn consistency_is_the_worst_frame_if_that_is_bad() {
    let mut poses = [pose(0.3, 0.2); 8];
    assert_eq!(consistency(&poses), 1.0);
    poses[5] = pose(0.3, 2.5);
    poses[6] = pose(0.3, 2.0);
    assert_eq!(consistency(&poses), by_the_word(&poses[5]));
    poses[5] = pose(0.3, 1.2);
    assert_eq!(consistency(&poses), by_the_word(&poses[6]));
}

#[test]
fn beat_rewards_are_as_defined() {
    let cases = [(false, false), (false, true), (true, false), (true, true)];
    let of = |rule: BeatReward, music: bool, dance: bool| {
        let beats = |any: bool, at: usize| if any { vec![3, at, 40] } else { vec![3, 40] };
        rule.of(&beats(music, 16), &beats(dance, 23), 16..24)
    };
    let paper = cases.map(|(music, dance)| of(BeatReward::Paper, music, dance));
    assert_eq!(paper, [1.0, 1.0, -1.0, 1.0]);
    for (music, dance) in cases {
        let product = f64::from(u8::from(music && dance));
        let found = 5.0 * of(BeatReward::Reference, music, dance);
        assert_eq!(found, (product - 0.5) * 10.0);
    }
    let near = |d: f64| (-d * d / 18.0).exp();
    let align = |music: &[usize], dance: &[usize]| BeatReward::Align.of(music, dance, 16..24);
    assert_eq!(align(&[3, 40], &[15, 24]), 0.0);
    assert_eq!(align(&[20], &[20]), 1.0);
    assert_eq!(align(&[20], &[]), -1.0);
    // A music beat beside a dance beat of the next code; two dance beats, one of them far off.
    assert!((align(&[22], &[25]) - (2.0 * near(3.0) - 1.0)).abs() < 1e-12);
    let mean = (near(1.0) + near(1.0) + near(6.0)) / 3.0;
    assert!((align(&[23], &[17, 22]) - (2.0 * mean - 1.0)).abs() < 1e-12);
}

#[test]
fn a_margin_is_what_is_above_chance() {
    let near = |d: f64| (-d * d / 18.0).exp();
    let margin = |dance: &[usize]| BeatReward::Margin.of(&[10, 30, 50], dance, 24..32);
    // Frames 20 to 39 are nearest to the music beat at 30.
    let chance = (20..40).map(|frame| near(f64::from(frame) - 30.0)).sum::<f64>() / 20.0;
    assert!((margin(&[30]) - (1.0 - chance)).abs() < 1e-12);
    assert!((margin(&[10, 30, 50]) - (1.0 - chance)).abs() < 1e-2);
    assert!(margin(&[40]) < -0.15, "{}", margin(&[40]));
    assert_eq!(margin(&[]), 0.0);
    // Beats everywhere are on every beat, and gain nothing.
    let everywhere: Vec<usize> = (0..60).collect();
    assert!(margin(&everywhere).abs() < 1e-12);
    // No music beat among the frames, or no other one to measure the distance to.
    assert_eq!(BeatReward::Margin.of(&[10, 50], &[30], 24..32), 0.0);
    assert_eq!(BeatReward::Margin.of(&[30], &[30], 24..32), 0.0);
}

/// Everything moves along x with a speed that is slowest at frames 20, 60, 100, ..
fn dance(frames: usize) -> Positions {
    let still = pose(0.0, 0.0);
    let mut moved = 0.0;
    let mut places = Positions::zeros((frames, 24, 3));
    for (frame, mut row) in places.outer_iter_mut().enumerate() {
        for (joint, mut cell) in row.outer_iter_mut().enumerate() {
            let place = still[joint] + DVec3::new(moved, 0.0, 0.0);
            for (axis, value) in cell.iter_mut().enumerate() {
                *value = place[axis] as f32;
            }
        }
        let phase = std::f64::consts::TAU * (frame as f64 - 20.0) / 40.0;
        moved += 0.02 * (1.5 - phase.cos());
    }
    places
}

#[test]
fn rewards_are_those_of_the_whole_piece() {
    let positions = dance(160);
    let beats = |at: &[usize]| {
        let mut beats = vec![false; 150];
        at.iter().for_each(|&frame| beats[frame] = true);
        beats
    };
    let rule = rule(BeatReward::Paper, 5.0, 1.0);
    // Dance beats are in the codes of frames 20 (code 2), 60 (7), 100 (12) and 140 (17).
    let rewards = rule.rewards(&positions, &beats(&[16, 23, 40, 56, 104]));
    assert_eq!(rewards.len(), 20);
    for (code, reward) in rewards.iter().enumerate() {
        let missed = code == 5 || code == 13;
        let beat = if missed { -1.0 } else { 1.0 };
        assert_eq!((reward.beat, reward.consistency), (beat, 1.0), "{code}");
        assert_eq!(reward.total, 5.0 * beat + 1.0);
    }
    let rule = self::rule(BeatReward::Reference, 5.0, 0.0);
    let rewards = rule.rewards(&positions, &beats(&[16, 23, 40, 56, 104]));
    let good = rewards.iter().enumerate().filter(|(_, r)| r.total == 5.0);
    assert_eq!(good.map(|(code, _)| code).collect::<Vec<_>>(), [2, 7]);
    assert!(rewards.iter().all(|reward| reward.total.abs() == 5.0));
    let quick = RewardRule { speed_weight: 0.5, ..rule };
    // Half of the metres that a second's frames move, beside the same beats.
    let quick = quick.rewards(&positions, &beats(&[16, 23, 40, 56, 104]));
    let speed = speed(&poses(&positions));
    for (code, (quick, plain)) in quick.iter().zip(&rewards).enumerate() {
        let steps = &speed[8 * code..(8 * code + 8).min(speed.len())];
        let gained = 0.5 * 60.0 * steps.iter().sum::<f64>() / steps.len() as f64;
        assert!(gained > 0.1 && (quick.total - plain.total - gained).abs() < 1e-12);
    }
    assert!(rule.rewards(&dance(0), &[]).is_empty());
}

#[test]
fn a_dance_that_is_slowest_on_the_beats_goes_with_the_pulse() {
    let rule = rule(BeatReward::Pulse, 1.0, 0.0);
    let positions = dance(200);
    // The speed is slowest at frames 20, 60, 100, ..; its smoothing mirrors the ends.
    let mean_reward = |first: usize| {
        let mut beats = vec![false; 200];
        (first..200).step_by(40).for_each(|frame| beats[frame] = true);
        let rewards = rule.rewards(&positions, &beats);
        // Codes that lie between the first and the last beat.
        let inner = &rewards[first.div_ceil(8)..(first + 120) / 8];
        inner.iter().map(|reward| reward.beat).sum::<f64>() / inner.len() as f64
    };
    let (on, off, between) = (mean_reward(20), mean_reward(40), mean_reward(30));
    assert!(on > 0.9 && off < -0.9 && between.abs() < 0.2, "{on} {off} {between}");
    // Twice as fast goes with it as well as before.
    let twice = positions.mapv(|metres| 2.0 * metres);
    let mut beats = vec![false; 200];
    (20..200).step_by(40).for_each(|frame| beats[frame] = true);
    let (own, faster) = (rule.rewards(&positions, &beats), rule.rewards(&twice, &beats));
    for (own, faster) in own.iter().zip(&faster) {
        assert!((own.beat - faster.beat).abs() < 1e-3);
    }
    // Nothing to go with.
    assert!(rule.rewards(&positions, &[]).iter().all(|reward| reward.beat == 0.0));
}
