//! The report, for people and as JSON.

use std::{
    collections::{BTreeSet, HashMap},
    fmt,
    path::PathBuf,
};

use serde::Serialize;

use super::{Finding, Severity};
use crate::data::{Dataset, MotionSource, Split};

/// Places of one finding that the text lists; JSON has all.
const SHOWN: usize = 5;

/// Everything that was found out about a folder.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// The folder.
    pub folder: PathBuf,
    /// Its layout.
    pub layout: String,
    /// Counts of train and test.
    pub splits: Vec<SplitSummary>,
    /// Motion files looked at.
    pub motions_checked: usize,
    /// Songs decoded.
    pub songs_decoded: usize,
    /// Songs whose beats were tracked.
    pub beats_compared: usize,
    /// What is wrong or remarkable, worst first.
    pub findings: Vec<Finding>,
}

/// Counts of one split.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SplitSummary {
    /// `train` or `test`.
    pub split: String,
    /// Pairs of motion and song.
    pub pieces: usize,
    /// Minutes of all pieces.
    pub minutes: f64,
    /// Different motion files.
    pub dances: usize,
    /// Minutes of these.
    pub dance_minutes: f64,
    /// Different songs.
    pub songs: usize,
}

pub(super) fn summary(
    dataset: &Dataset,
    split: Split,
    frames: &HashMap<&MotionSource, usize>,
) -> SplitSummary {
    let pieces = dataset.pieces.iter().filter(|piece| piece.split == split);
    let minutes = |motion| frames.get(motion).map_or(0.0, |&n| n as f64 / 3_600.0);
    let (mut dances, mut songs) = (BTreeSet::new(), BTreeSet::new());
    let (mut count, mut paired) = (0, 0.0);
    for piece in pieces {
        count += 1;
        paired += minutes(&piece.motion);
        dances.insert(&piece.motion);
        songs.extend(&piece.music);
    }
    SplitSummary {
        split: split.to_string(),
        pieces: count,
        minutes: paired,
        dances: dances.len(),
        // The empty sum of floats is minus zero.
        dance_minutes: dances.into_iter().map(minutes).fold(0.0, |a, b| a + b),
        songs: songs.len(),
    }
}

impl Report {
    /// Findings of one severity.
    pub fn of(&self, severity: Severity) -> impl Iterator<Item = &Finding> {
        let findings = self.findings.iter();
        findings.filter(move |finding| finding.severity == severity)
    }

    /// Whether a training may start.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.of(Severity::Unusable).next().is_none()
    }

    /// The last line of the text.
    #[must_use]
    pub fn verdict(&self) -> String {
        let count = |severity| self.of(severity).count();
        let (problems, warnings) = (count(Severity::Unusable), count(Severity::Warning));
        match (problems, warnings) {
            (0, 0) => "usable, nothing to complain about".into(),
            (0, _) => format!("usable, with {}", plural(warnings, "warning")),
            _ => format!(
                "not usable as it is: {}, {}",
                plural(problems, "problem"),
                plural(warnings, "warning")
            ),
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}", self.folder.display(), self.layout)?;
        writeln!(f)?;
        let header = ["", "pieces", "minutes", "dances", "minutes", "songs"];
        let [a, b, c, d, e, g] = header;
        writeln!(f, "  {a:<6}{b:>8}{c:>9}{d:>9}{e:>9}{g:>8}")?;
        for s in &self.splits {
            let (paired, danced) = (s.minutes, s.dance_minutes);
            writeln!(
                f,
                "  {:<6}{:>8}{paired:>9.1}{:>9}{danced:>9.1}{:>8}",
                s.split, s.pieces, s.dances, s.songs
            )?;
        }
        writeln!(f)?;
        writeln!(
            f,
            "looked at {}, {}, the beats of {}",
            plural(self.motions_checked, "motion"),
            plural(self.songs_decoded, "song"),
            self.beats_compared
        )?;
        writeln!(f)?;
        for finding in &self.findings {
            write_finding(f, finding)?;
        }
        writeln!(f, "result: {}", self.verdict())
    }
}

fn write_finding(f: &mut fmt::Formatter<'_>, finding: &Finding) -> fmt::Result {
    let label = match finding.severity {
        Severity::Unusable => "PROBLEM",
        Severity::Warning => "warning",
        Severity::Note => "note",
    };
    writeln!(f, "{label}: {}", finding.meaning)?;
    for place in finding.places.iter().take(SHOWN) {
        writeln!(f, "  - {place}")?;
    }
    let more = finding.places.len().saturating_sub(SHOWN);
    if more > 0 {
        writeln!(f, "  - and {more} more (--json lists all)")?;
    }
    if !finding.advice.is_empty() {
        writeln!(f, "  what helps: {}", finding.advice)?;
    }
    writeln!(f)
}

fn plural(count: usize, what: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {what}{ending}")
}
