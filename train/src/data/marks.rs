//! What the data say about a motion beside its frames.

use std::ops::Range;

/// Style, phrases and damage of a motion, where the data have them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Marks {
    /// Name of its style.
    pub style: Option<String>,
    /// Phrases that it is put together from, ascending.
    pub phrases: Vec<Phrase>,
    /// Stretches of frames that are not what the dancer did.
    pub damaged: Vec<Range<usize>>,
    /// Number, from 1 on, that the first beat has in its bar of four.
    pub first_count: usize,
}

/// A phrase in its place in a motion; it lasts until the next, or until the motion ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Phrase {
    /// First frame.
    pub start_frame: usize,
    /// Name of what was danced: the same phrase may stand in several motions.
    pub name: String,
}

impl Marks {
    /// Returns the phrase that a frame lies in.
    #[must_use]
    pub fn phrase_at(&self, frame: usize) -> Option<&Phrase> {
        let after = self.phrases.partition_point(|phrase| phrase.start_frame <= frame);
        self.phrases.get(after.checked_sub(1)?)
    }

    /// Returns the share of some frames that is marked as damaged.
    #[must_use]
    pub fn damaged_share(&self, frames: Range<usize>) -> f64 {
        let overlap = |stretch: &Range<usize>| {
            stretch.end.min(frames.end).saturating_sub(stretch.start.max(frames.start))
        };
        let damaged: usize = self.damaged.iter().map(overlap).sum();
        (damaged as f64 / frames.len().max(1) as f64).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_phrase_lasts_until_the_next() {
        let phrase = |start_frame, name: &str| Phrase { start_frame, name: name.into() };
        let marks = Marks { phrases: vec![phrase(10, "a"), phrase(200, "b")], ..Marks::default() };
        let name = |frame| marks.phrase_at(frame).map(|phrase| phrase.name.as_str());
        assert_eq!(
            [9, 10, 199, 200, 9_999].map(name),
            [None, Some("a"), Some("a"), Some("b"), Some("b")]
        );
    }

    #[test]
    fn damage_is_a_share_of_the_frames() {
        let marks = Marks { damaged: vec![0..10, 40..60], ..Marks::default() };
        assert_eq!(marks.damaged_share(0..100), 0.3);
        assert_eq!(marks.damaged_share(50..70), 0.5);
        assert_eq!(marks.damaged_share(10..40), 0.0);
        assert_eq!(Marks::default().damaged_share(0..0), 0.0);
    }
}
