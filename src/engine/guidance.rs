//! Classifier-free guidance (Ho and Salimans 2022) of the next codes by the music.

use ndarray::{Array2, ArrayView1, ArrayView2, Axis, Slice};

use crate::{features::COLUMNS, model::MannerSpec};

/// Rows of the batch that one sequence takes: a second one without the music's time where it is
/// guided.
pub(crate) fn branches(guidance: f32) -> usize {
    1 + usize::from(guidance != 1.0)
}

/// The conditioning without its time and manner, and how far a sequence is guided away from it.
#[derive(Clone, Debug)]
pub(crate) struct ClassifierFreeGuidance {
    guidance: f32,
    timeless: Array2<f32>,
}

impl ClassifierFreeGuidance {
    /// Guidance for feature rows `[rows, columns]`, the columns of these manners last; none for 1,
    /// which is the model as it is.
    ///
    /// Without time the rows are their mean. Where the model is conditioned on counts, only those
    /// columns are: the song stays known, and only the place of its beats is left out. Style and
    /// energy are not given at all, so that guidance strengthens them too.
    pub(crate) fn new(
        guidance: f32,
        music: ArrayView2<'_, f32>,
        manners: MannerSpec,
    ) -> Option<Self> {
        if guidance == 1.0 {
            return None;
        }
        let end = music.ncols() - manners.columns();
        let first = if end > COLUMNS { COLUMNS } else { 0 };
        let mut timeless = music.to_owned();
        timeless.slice_axis_mut(Axis(1), Slice::from(end..)).fill(0.0);
        let mut timed = timeless.slice_axis_mut(Axis(1), Slice::from(first..end));
        let mean = timed.mean_axis(Axis(0))?;
        timed.rows_mut().into_iter().for_each(|mut row| row.assign(&mean));
        Some(Self { guidance, timeless })
    }

    /// Feature rows without time, as many as with it.
    pub(crate) fn timeless(&self) -> ArrayView2<'_, f32> {
        self.timeless.view()
    }

    /// Guides logits with time away from those without: 0 gives those without, 1 those with, and
    /// more exaggerates what the music's time changes.
    pub(crate) fn guide<'a>(
        &self,
        with_time: ArrayView1<'a, f32>,
        without: ArrayView1<'a, f32>,
    ) -> impl Iterator<Item = f32> {
        let guidance = self.guidance;
        let pairs = with_time.into_iter().zip(without);
        pairs.map(move |(with_time, without)| without + guidance * (with_time - without))
    }
}

#[cfg(test)]
mod tests {
    use ndarray::{array, aview1};

    use super::*;

    const NONE: MannerSpec = MannerSpec { styles: 0, energy: false };

    #[test]
    fn without_time_no_style_is_given() {
        let styles = MannerSpec { styles: 2, energy: false };
        for columns in [2, COLUMNS, COLUMNS + 2] {
            let music = Array2::from_shape_fn((4, columns), |(row, _)| row as f32);
            let style = Array2::from_shape_fn((4, 2), |(_, column)| column as f32);
            let with_style = ndarray::concatenate![Axis(1), music, style];
            let timeless = |music: &Array2<f32>, manners| {
                let guide = ClassifierFreeGuidance::new(2.0, music.view(), manners).unwrap();
                guide.timeless().to_owned()
            };
            let wanted =
                ndarray::concatenate![Axis(1), timeless(&music, NONE), Array2::zeros((4, 2))];
            assert_eq!(timeless(&with_style, styles), wanted);
        }
    }

    #[test]
    fn a_song_without_time_keeps_all_but_its_counts() {
        let music = Array2::from_shape_fn((3, COLUMNS + 2), |(row, column)| {
            (row * row) as f32 + column as f32
        });
        let guide = ClassifierFreeGuidance::new(2.0, music.view(), NONE).unwrap();
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
        let guide = ClassifierFreeGuidance::new(0.5, music.view(), NONE).unwrap();
        assert_eq!(guide.timeless(), array![[1.0, 6.0], [1.0, 6.0]]);
        assert!(ClassifierFreeGuidance::new(1.0, music.view(), NONE).is_none());
    }

    #[test]
    fn what_time_changes_is_exaggerated() {
        for (guidance, wanted) in [(0.0, [1.0, 0.0]), (1.0, [1.0, 2.0]), (3.0, [1.0, 6.0])] {
            let guide = ClassifierFreeGuidance { guidance, timeless: array![[0.0]] };
            let guided = guide.guide(aview1(&[1.0, 2.0]), aview1(&[1.0, 0.0]));
            assert_eq!(guided.collect::<Vec<_>>(), wanted);
        }
    }
}
