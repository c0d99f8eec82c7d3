//! The styles and energies that the network is told beside the music.

use bailando::model::{Manner, MannerSpec};
use serde::{Deserialize, Serialize};

use super::checkpoint::Checkpoint;

/// Name in the facts of checkpoints.
const MANNERS: &str = "manners";

/// What a network is told beside the music.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Manners {
    /// Names of the styles, in the order of their columns.
    pub(super) styles: Vec<String>,
    pub(super) energy: bool,
}

impl Manners {
    /// Returns their numbers, as a manifest has them.
    pub(super) fn spec(&self) -> MannerSpec {
        MannerSpec { styles: self.styles.len(), energy: self.energy }
    }

    /// Adds them to a checkpoint.
    #[expect(clippy::expect_used, reason = "names and a truth value are JSON")]
    pub(super) fn save(&self, checkpoint: &mut Checkpoint) {
        if *self != Self::default() {
            let text = serde_json::to_string(self).expect("manners can be written as JSON");
            checkpoint.facts.insert(MANNERS.into(), text);
        }
    }

    /// Reads those of a checkpoint; none where it has none.
    pub(super) fn restore(checkpoint: &Checkpoint) -> Result<Self, String> {
        let Some(text) = checkpoint.facts.get(MANNERS) else {
            return Ok(Self::default());
        };
        serde_json::from_str(text).map_err(|error| format!("`{MANNERS}`: {error}"))
    }

    /// Returns the manner of a style of this name, if it is known.
    pub(super) fn of_style(&self, name: Option<&str>) -> Manner {
        let style = self.styles.iter().position(|style| Some(style.as_str()) == name);
        Manner { style, energy: None }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    #[test]
    fn they_come_back_from_a_checkpoint_and_stand_beside_the_music() {
        let manners = Manners { styles: vec!["lock".into(), "pop".into()], energy: true };
        let mut checkpoint = Checkpoint::default();
        assert_eq!(Manners::restore(&checkpoint), Ok(Manners::default()));
        manners.save(&mut checkpoint);
        assert_eq!(Manners::restore(&checkpoint), Ok(manners.clone()));
        let beside =
            |style| manners.spec().beside(array![[7.0], [8.0]].view(), manners.of_style(style));
        let wanted = array![[7.0, 0.0, 1.0, 0.0, 0.0], [8.0, 0.0, 1.0, 0.0, 0.0]];
        assert_eq!(beside(Some("pop")), wanted);
        assert_eq!(beside(Some("waltz")).row(0).to_vec(), [7.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(beside(None), beside(Some("waltz")));
    }
}
