//! Guidance by the music: classifier-free guidance (Ho and Salimans 2022) of a GPT's next codes.

use ndarray::{Array2, ArrayView1, ArrayView2, Axis, Slice};

use crate::features::COLUMNS;

/// A song without its time, and how far a dance is led away from what it would be to that.
#[derive(Clone, Debug)]
pub(crate) struct Guide {
    guidance: f32,
    timeless: Array2<f32>,
}

impl Guide {
    /// For music rows `[rows, columns]`. None for a guidance of 1, which is the model as it is.
    ///
    /// Without time a song is the mean of its rows; where the model is given counts, only these
    /// are: which song it is stays known, and what is left apart is where its beat is.
    pub(crate) fn new(guidance: f32, music: ArrayView2<'_, f32>) -> Option<Self> {
        if guidance == 1.0 {
            return None;
        }
        let first = if music.ncols() > COLUMNS { COLUMNS } else { 0 };
        let mut timeless = music.to_owned();
        let mut timed = timeless.slice_axis_mut(Axis(1), Slice::from(first..));
        let mean = timed.mean_axis(Axis(0))?;
        timed
            .rows_mut()
            .into_iter()
            .for_each(|mut row| row.assign(&mean));
        Some(Self { guidance, timeless })
    }

    /// Rows of the song without time, as many as it has.
    pub(crate) fn timeless(&self) -> ArrayView2<'_, f32> {
        self.timeless.view()
    }

    /// Leads `heard` away from `unheard`: at 0 it becomes that, at 1 it stays, beyond it exaggerates
    /// what the music's time changes.
    pub(crate) fn lead<'a>(
        &self,
        heard: ArrayView1<'a, f32>,
        unheard: ArrayView1<'a, f32>,
    ) -> impl Iterator<Item = f32> {
        let guidance = self.guidance;
        let pairs = heard.into_iter().zip(unheard);
        pairs.map(move |(heard, unheard)| unheard + guidance * (heard - unheard))
    }
}

#[cfg(test)]
mod tests {
    use ndarray::{array, aview1};

    use super::*;

    #[test]
    fn a_song_without_time_keeps_all_but_its_counts() {
        let music = Array2::from_shape_fn((3, COLUMNS + 2), |(row, column)| {
            (row * row) as f32 + column as f32
        });
        let guide = Guide::new(2.0, music.view()).unwrap();
        let timeless = guide.timeless();
        assert_eq!(
            timeless.slice_axis(Axis(1), Slice::from(..COLUMNS)),
            music.slice_axis(Axis(1), Slice::from(..COLUMNS))
        );
        for row in timeless.rows() {
            for column in COLUMNS..COLUMNS + 2 {
                assert!((row[column] - (column as f32 + 5.0 / 3.0)).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn without_counts_all_of_a_song_is_its_mean() {
        let music = array![[0.0, 4.0], [2.0, 8.0]];
        let guide = Guide::new(0.5, music.view()).unwrap();
        assert_eq!(guide.timeless(), array![[1.0, 6.0], [1.0, 6.0]]);
        assert!(Guide::new(1.0, music.view()).is_none());
    }

    #[test]
    fn what_time_changes_is_exaggerated() {
        for (guidance, wanted) in [(0.0, [1.0, 0.0]), (1.0, [1.0, 2.0]), (3.0, [1.0, 6.0])] {
            let guide = Guide {
                guidance,
                timeless: array![[0.0]],
            };
            let led = guide.lead(aview1(&[1.0, 2.0]), aview1(&[1.0, 0.0]));
            assert_eq!(led.collect::<Vec<_>>(), wanted);
        }
    }
}
