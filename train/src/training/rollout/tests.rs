use ndarray::Array2;

use super::*;

fn plan() -> RolloutPlan {
    let song = |rows: usize| Song {
        rows: Array2::zeros((rows, 2)),
        beats: (0..8 * rows).map(|frame| frame == 16).collect(),
        style: None,
    };
    let mut plan = RolloutPlan {
        songs: vec![song(12), song(4), song(30)],
        pieces: 5,
        codes: 16,
        takes: 1,
        continued: 0.0,
        block: 6,
        seed: 3,
    };
    plan.keep_usable();
    plan
}

#[test]
fn takes_are_compared_with_each_other() {
    let plan = RolloutPlan { takes: 2, ..plan() };
    let excerpts = plan.excerpts(4);
    assert_eq!(excerpts.len(), 5);
    assert_eq!((excerpts[0], excerpts[2]), (excerpts[1], excerpts[3]));
    let take = |rewards: [f32; 2]| Episode {
        excerpt: excerpts[0],
        codes: [vec![0; 2], vec![0; 2]],
        rewards: rewards.map(|reward| [reward, 1.0, 2.0 * reward]).to_vec(),
    };
    let mut takes = [take([1.0, 5.0]), take([3.0, -5.0])];
    assert_eq!(mean_rewards(&takes), [1.0, 1.0, 2.0]);
    compare(&mut takes);
    assert_eq!(takes[0].rewards, [[-1.0, 0.0, -2.0], [5.0, 0.0, 10.0]]);
    assert_eq!(takes[1].rewards, [[1.0, 0.0, 2.0], [-5.0, 0.0, -10.0]]);
}

#[test]
fn pieces_go_on_from_earlier_ends_as_often_as_asked() {
    let share = |continued: f64, ends: &[[i32; 2]]| {
        let plan = RolloutPlan { continued, ..plan() };
        let found = (0..1000).filter_map(|piece| plan.continued_from(2, piece, ends));
        let found: Vec<_> = found.collect();
        assert!(found.iter().all(|end| ends.contains(end)));
        let distinct: std::collections::HashSet<_> = found.iter().collect();
        (found.len(), distinct.len())
    };
    let ends = [[1, 2], [3, 4], [5, 6]];
    assert_eq!(share(0.0, &ends), (0, 0));
    assert_eq!(share(1.0, &ends), (1000, 3));
    assert_eq!(share(1.0, &[]), (0, 0));
    let (found, distinct) = share(0.8, &ends);
    assert!((760..840).contains(&found) && distinct == 3, "{found}");
    assert_eq!(rollout(3).ends()[2], [2, 4]);
}

fn rollout(epoch: u64) -> Rollout {
    let plan = plan();
    let excerpts = plan.excerpts(epoch).into_iter().enumerate();
    let episodes = excerpts.map(|(piece, excerpt)| Episode {
        excerpt,
        codes: [1, 2].map(|half| vec![half * piece as i32; excerpt.codes]),
        rewards: vec![[piece as f32, 0.1, -0.3]; excerpt.codes],
    });
    plan.arranged(epoch, [0.5, 0.1, -0.3], episodes.collect())
}

#[test]
fn excerpts_lie_within_their_songs() {
    let plan = plan();
    assert_eq!(plan.songs.len(), 2);
    let mut firsts = Vec::new();
    for epoch in 0..20 {
        let excerpts = plan.excerpts(epoch);
        assert_eq!(excerpts, plan.excerpts(epoch));
        assert_eq!(excerpts.len(), 5);
        for excerpt in excerpts {
            let rows = plan.songs[excerpt.song].rows.nrows();
            assert_eq!(excerpt.codes, 16.min(rows - 1));
            assert_eq!(plan.music(excerpt).nrows(), excerpt.codes + 1);
            let beat = plan.beats(excerpt).iter().position(|&beat| beat);
            assert_eq!(beat, 16_usize.checked_sub(8 * excerpt.first));
            firsts.push(excerpt.first);
        }
    }
    firsts.sort_unstable();
    firsts.dedup();
    assert_eq!(firsts, (0..=13).collect::<Vec<_>>());
}

#[test]
fn an_epoch_is_about_every_window_once() {
    let rollout = rollout(2);
    let mut drawn: Vec<_> = (0..).map(|step| rollout.batch(step, 7)).take(30).collect();
    let windows = rollout.windows.len();
    drawn.truncate(windows.div_ceil(7));
    let mut drawn = drawn.concat();
    // The last batch starts over.
    assert_eq!(drawn.split_off(windows), drawn[..drawn.len().div_ceil(7) * 7 - windows]);
    drawn.sort_unstable();
    let all = rollout.episodes.iter().enumerate();
    let all = all.flat_map(|(piece, e)| (0..=e.codes[0].len() - 6).map(move |at| (piece, at)));
    assert_eq!(drawn, all.collect::<Vec<_>>());
}

#[test]
fn what_was_generated_is_kept() {
    let (plan, rollout) = (plan(), rollout(9));
    let mut checkpoint = Checkpoint::default();
    assert!(plan.restore(&checkpoint).unwrap().is_none());
    rollout.save(&mut checkpoint);
    let back = plan.restore(&checkpoint).unwrap().unwrap();
    assert_eq!((back.epoch, &back.windows), (9, &rollout.windows));
    assert_eq!(back.mean_rewards, rollout.mean_rewards);
    for (found, wanted) in back.episodes.iter().zip(&rollout.episodes) {
        assert_eq!(found.excerpt, wanted.excerpt);
        assert_eq!(found.codes, wanted.codes);
        assert_eq!(found.rewards, wanted.rewards);
    }
    checkpoint.put_rows(CODES, 2, &[0.0; 6]);
    assert!(plan.restore(&checkpoint).is_err());
}
