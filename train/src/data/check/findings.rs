//! Collected findings, grouped by topic.

use std::{collections::BTreeMap, path::Path};

use serde::Serialize;

pub use super::topic::{Severity, Topic};

/// One topic with every place where it was found.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// What was found.
    pub topic: Topic,
    /// How bad it is.
    pub severity: Severity,
    /// What it means.
    pub meaning: &'static str,
    /// What to do about it.
    pub advice: &'static str,
    /// Where, each in one line.
    pub places: Vec<String>,
}

/// Findings under way.
#[derive(Debug, Default)]
pub(super) struct Findings {
    places: BTreeMap<Topic, Vec<String>>,
}

impl Findings {
    pub(super) fn add(&mut self, topic: Topic, place: String) {
        self.places.entry(topic).or_default().push(place);
    }

    /// Worst first.
    pub(super) fn into_list(self) -> Vec<Finding> {
        let finding = |(topic, places): (Topic, Vec<String>)| Finding {
            topic,
            severity: topic.severity(),
            meaning: topic.meaning(),
            advice: topic.advice(),
            places,
        };
        let mut list: Vec<Finding> = self.places.into_iter().map(finding).collect();
        list.sort_by_key(|finding| (finding.severity, finding.topic));
        list
    }
}

/// Returns the name under which findings mention a file.
pub(super) fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}
