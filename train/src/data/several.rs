//! Several data folders as one.

use std::{collections::HashMap, path::PathBuf};

use bailando::motion::Skeleton;
use serde::{Deserialize, Serialize};

use super::{DataError, Dataset, Defect, OpenOptions};

/// Largest difference of two skeletons' offsets in metres.
const SAME: f32 = 1e-3;

/// A data folder, and how much its motions count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataFolder {
    /// The folder, of any layout.
    pub path: PathBuf,
    /// How often a window of it is learned from, beside one of a folder of weight 1.
    #[serde(default = "one")]
    pub weight: f64,
}

fn one() -> f64 {
    1.0
}

impl Dataset {
    /// Opens folders as one data set; all must have the same skeleton, and other pieces.
    ///
    /// # Errors
    /// As [`Dataset::open`]; [`DataError::Skeleton`]; [`DataError::Entry`] for an id that two
    /// folders have.
    pub fn open_all(folders: &[DataFolder], options: &OpenOptions) -> Result<Self, DataError> {
        let mut all: Option<Self> = None;
        for (place, folder) in folders.iter().enumerate() {
            let mut next = Self::open(&folder.path, options)?;
            for piece in &mut next.pieces {
                (piece.folder, piece.weight) = (place, folder.weight);
            }
            match &mut all {
                Some(all) => all.join(next)?,
                None => all = Some(next),
            }
        }
        all.ok_or(DataError::NoFolder)
    }

    fn join(&mut self, other: Self) -> Result<(), DataError> {
        if let Some(what) = difference(&self.skeleton, &other.skeleton) {
            return Err(DataError::Skeleton { first: self.root.clone(), other: other.root, what });
        }
        let known: HashMap<&str, usize> =
            self.pieces.iter().map(|piece| (piece.id.as_str(), piece.folder)).collect();
        if let Some(twice) = other.pieces.iter().find(|piece| known.contains_key(&*piece.id)) {
            let Defect { piece, what } = Defect {
                piece: twice.id.clone(),
                what: "another data folder has a piece of this id".into(),
            };
            return Err(DataError::Entry { path: other.root, piece, what });
        }
        self.pieces.extend(other.pieces);
        self.notes.extend(other.notes);
        Ok(())
    }
}

/// Says how two skeletons differ.
fn difference(first: &Skeleton, other: &Skeleton) -> Option<String> {
    if first.parents != other.parents {
        return Some("other joints or parents".into());
    }
    let pairs = first.joints.iter().zip(first.offsets.iter().zip(&other.offsets));
    let mut apart = pairs.filter_map(|(name, (one, other))| {
        let distances = one.iter().zip(other).map(|(one, other)| (one - other).abs());
        let distance = distances.fold(0.0, f32::max);
        (distance > SAME).then(|| format!("the offset of {name} differs by {distance:.3} m"))
    });
    apart.next()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::{
        data::{Split, testing::TestFolder},
        export::skeleton,
    };

    /// A folder whose ids and motions are no other's.
    fn folder(prefix: &str, seed: u32) -> TestFolder {
        let mut folder = TestFolder::good(&skeleton(0.93));
        for (number, name) in (0..).zip(["one", "two", "three"]) {
            let motion = crate::data::testing::dance(&skeleton(0.93), 600, seed + number);
            folder.motion(&format!("{name}.npy"), &motion);
        }
        for id in ["one_a", "one_b", "two_a", "three_a"] {
            folder.set(id, "id", json!(format!("{prefix}_{id}")));
        }
        folder
    }

    fn folders(paths: &[&std::path::Path]) -> Vec<DataFolder> {
        let folder = |(place, path): (usize, &&std::path::Path)| DataFolder {
            path: path.to_path_buf(),
            weight: 1.0 + place as f64,
        };
        paths.iter().enumerate().map(folder).collect()
    }

    #[test]
    fn folders_come_in_their_order_with_their_weights() {
        let (first, second) = (folder("z", 10), folder("a", 20));
        let paths = folders(&[first.write(), second.write()]);
        let all = Dataset::open_all(&paths, &OpenOptions::default()).unwrap();
        let training = all.training().unwrap();
        let found: Vec<_> = training
            .recordings()
            .iter()
            .map(|recording| (recording.songs()[0].id.as_str(), recording.weight()))
            .collect();
        let wanted = [("z_one_a", 1.0), ("z_two_a", 1.0), ("a_one_a", 2.0), ("a_two_a", 2.0)];
        assert_eq!(found, wanted);
        let tests = all.pieces.iter().filter(|piece| piece.split == Split::Test);
        assert_eq!(tests.count(), 2);
    }

    #[test]
    fn another_skeleton_and_a_known_id_are_refused() {
        let (first, second) = (folder("z", 10), folder("z", 20));
        let open = |paths: &[DataFolder]| {
            let opened = Dataset::open_all(paths, &OpenOptions::default());
            opened.map(drop).unwrap_err().to_string()
        };
        let refused = open(&folders(&[first.write(), second.write()]));
        assert!(
            refused.contains("z_one_a") && refused.contains("another data folder"),
            "{refused}"
        );

        let mut third = folder("a", 30);
        third.index["offsets"][4] = json!([0.04, -0.5, 0.0]);
        let refused = open(&folders(&[first.write(), third.write()]));
        assert!(refused.contains("same skeleton") && refused.contains("l_knee"), "{refused}");
        assert!(open(&[]).contains("no data folder"));
    }

    #[test]
    fn a_test_motion_of_one_folder_among_the_training_of_another_is_refused() {
        let (first, second) = (folder("z", 10), folder("a", 20));
        std::fs::copy(first.path("three.npy"), second.path("two.npy")).unwrap();
        let paths = folders(&[first.write(), second.write()]);
        let all = Dataset::open_all(&paths, &OpenOptions::default()).unwrap();
        assert!(matches!(all.training(), Err(DataError::Leak { .. })));
    }
}
