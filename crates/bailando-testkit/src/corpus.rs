//! The corpora of the fuzz targets as tests on any compiler.

use std::{fs, path::Path};

use proptest::{prelude::*, sample::Index, test_runner::TestRunner};

/// The seeds of one fuzz target.
pub struct Corpus {
    files: Vec<(String, Vec<u8>)>,
}

/// A change of a file, such as a fuzzer makes.
#[derive(Clone, Debug)]
enum Edit {
    Set(Index, u8),
    Flip(Index, u8),
    Cut(Index, Index),
    Repeat(Index, Index),
    /// A number that sizes are often written as.
    Size(Index, u64, usize),
}

impl Corpus {
    /// Reads all files of `target`, ordered by name.
    pub fn read(folder: &Path, target: &str) -> Self {
        let entries = fs::read_dir(folder.join(target)).unwrap();
        let mut files: Vec<(String, Vec<u8>)> = entries
            .map(|entry| {
                let entry = entry.unwrap();
                let name = entry.file_name().into_string().unwrap();
                (name, fs::read(entry.path()).unwrap())
            })
            .collect();
        files.sort();
        assert!(files.len() >= 10, "{target} has {} files", files.len());
        Self { files }
    }

    /// Checks that files named `good-` are accepted and those named `bad-` are not, then tries
    /// `cases` mutations.
    pub fn run(&self, cases: u32, accepts: impl Fn(&[u8]) -> bool) {
        for (name, bytes) in &self.files {
            let accepted = accepts(bytes);
            assert!(accepted || !name.starts_with("good-"), "{name} is refused");
            assert!(!accepted || !name.starts_with("bad-"), "{name} is accepted");
        }
        let config =
            ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
        let mutants = (any::<Index>(), prop::collection::vec(edit(), 1..8));
        let tried = TestRunner::new(config).run(&mutants, |(which, edits)| {
            let (_, bytes) = which.get(&self.files);
            let mut bytes = bytes.clone();
            for edit in &edits {
                apply(&mut bytes, edit);
            }
            let _ = accepts(&bytes);
            Ok(())
        });
        tried.unwrap();
    }
}

fn edit() -> impl Strategy<Value = Edit> {
    let size = prop_oneof![any::<u64>(), (0..64_u32).prop_map(|bits| 1 << bits), Just(u64::MAX)];
    prop_oneof![
        (any::<Index>(), any::<u8>()).prop_map(|(at, byte)| Edit::Set(at, byte)),
        (any::<Index>(), 0..8_u8).prop_map(|(at, bit)| Edit::Flip(at, 1 << bit)),
        any::<(Index, Index)>().prop_map(|(from, to)| Edit::Cut(from, to)),
        any::<(Index, Index)>().prop_map(|(from, to)| Edit::Repeat(from, to)),
        (any::<Index>(), size, 1..=8_usize)
            .prop_map(|(at, size, width)| Edit::Size(at, size, width)),
    ]
}

fn apply(bytes: &mut Vec<u8>, edit: &Edit) {
    if bytes.is_empty() {
        return;
    }
    let place = |index: &Index| index.index(bytes.len());
    let range = |from: &Index, to: &Index| {
        let (from, to) = (place(from), place(to));
        from.min(to)..from.max(to)
    };
    match edit {
        Edit::Set(at, byte) => {
            let at = place(at);
            bytes[at] = *byte;
        }
        Edit::Flip(at, bit) => {
            let at = place(at);
            bytes[at] ^= bit;
        }
        Edit::Cut(from, to) => drop(bytes.drain(range(from, to))),
        Edit::Repeat(from, to) => bytes.extend_from_within(range(from, to)),
        Edit::Size(at, size, width) => {
            let at = place(at);
            let end = bytes.len().min(at + width);
            bytes[at..end].copy_from_slice(&size.to_le_bytes()[..end - at]);
        }
    }
}
