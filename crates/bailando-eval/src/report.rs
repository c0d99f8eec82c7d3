//! What an evaluation found, as JSON or as a Markdown table.

use std::{collections::BTreeMap, fmt::Write};

use serde::Serialize;

use super::{
    interval::mean_and_margin,
    metric::{Metric, Scores, Wanted},
};

/// How an evaluation measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Protocol {
    /// Which parts of a motion are samples, in words.
    pub clips: String,
    /// `published` or `corrected` (not comparable with published figures).
    pub kinetic: &'static str,
    /// Where music beats come from, in words; none: there are none.
    pub beats: Option<String>,
    /// Samples of the reference.
    pub reference_samples: usize,
    /// Kinetic columns left out because they are constant in the reference.
    pub constant_kinetic_columns: Vec<usize>,
    /// Geometric columns left out because they are constant in the reference.
    pub constant_geometric_columns: Vec<usize>,
    /// Seed of the random shifts behind the chance level.
    pub chance_seed: u64,
}

/// What an evaluation found.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Generated dances; with several sets, the mean of each metric.
    #[serde(flatten)]
    pub generated: Scores,
    /// Half the width of the 95 % confidence interval of the mean over the sets, by metric; empty
    /// for one set.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub margin95: BTreeMap<&'static str, f64>,
    /// Each set by itself, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sets: Vec<Scores>,
    /// The reference's own test pieces against the whole reference.
    pub reference: Scores,
    /// How it was measured.
    pub protocol: Protocol,
    /// What a reader should know before comparing, in plain words.
    pub warnings: Vec<String>,
}

impl Report {
    /// Of one or more generated sets, each from another seed.
    pub(super) fn new(
        sets: Vec<Scores>,
        reference: Scores,
        protocol: Protocol,
        warnings: Vec<String>,
    ) -> Self {
        let count = |get: fn(&Scores) -> usize| sets.iter().map(get).max().unwrap_or(0);
        let mut generated = Scores::new(count(|set| set.pieces), count(|set| set.samples));
        let mut margin95 = BTreeMap::new();
        for metric in Metric::all() {
            let values: Vec<f64> = sets.iter().filter_map(|set| set.get(metric)).collect();
            // A mean over some of the sets would be compared with one over all.
            if values.len() != sets.len() {
                continue;
            }
            if let Some((mean, margin)) = mean_and_margin(&values) {
                generated.set(metric, mean);
                margin95.extend(margin.map(|margin| (metric.key(), margin)));
            }
        }
        Self {
            generated,
            margin95,
            sets: if sets.len() > 1 { sets } else { Vec::new() },
            reference,
            protocol,
            warnings,
        }
    }

    /// A Markdown table, one metric a row, with how it was measured below.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut text = String::new();
        // Writing to a string can't fail.
        let _ = self.table(&mut text).and_then(|()| self.notes(&mut text));
        text
    }

    fn table(&self, text: &mut String) -> std::fmt::Result {
        match self.sets.len() {
            0 => writeln!(text, "| metric | reference | generated |")?,
            sets => writeln!(
                text,
                "| metric | reference | generated, {sets} sets (± 95 %) |"
            )?,
        }
        writeln!(text, "|---|---|---|")?;
        let rows = [("pieces", self.reference.pieces, self.generated.pieces)];
        let samples = ("samples", self.reference.samples, self.generated.samples);
        for (title, reference, generated) in rows.into_iter().chain([samples]) {
            writeln!(text, "| {title} | {reference} | {generated} |")?;
        }
        for metric in Metric::all() {
            let cell = |scores: &Scores| match scores.get(metric) {
                Some(value) => format!("{value:.*}", metric.decimals()),
                None => "–".to_owned(),
            };
            let margin = match self.margin95.get(metric.key()) {
                Some(margin) => format!(" ± {margin:.*}", metric.decimals()),
                None => String::new(),
            };
            if self.reference.get(metric).is_some() || self.generated.get(metric).is_some() {
                let wanted = match metric.wanted() {
                    Wanted::Low => " ↓",
                    Wanted::High => " ↑",
                    Wanted::Alike => "",
                };
                let (title, reference) = (metric.title(), cell(&self.reference));
                let generated = cell(&self.generated);
                let worst = self.worst(metric);
                writeln!(
                    text,
                    "| {title}{wanted} | {reference} | {generated}{margin}{worst} |"
                )?;
            }
        }
        Ok(())
    }

    /// The largest of all sets, of a metric that is itself about the worst case: a mean would hide it.
    fn worst(&self, metric: Metric) -> String {
        let largest = self.sets.iter().filter_map(|set| set.get(metric));
        match largest.reduce(f64::max) {
            Some(largest) if metric == Metric::SlowestWindow => {
                format!(", {largest:.*} at most", metric.decimals())
            }
            _ => String::new(),
        }
    }

    fn notes(&self, text: &mut String) -> std::fmt::Result {
        let protocol = &self.protocol;
        writeln!(
            text,
            "\nSamples: {}; reference: {} samples. Kinetic features: {} form. Music beats: {}.",
            protocol.clips,
            protocol.reference_samples,
            protocol.kinetic,
            protocol.beats.as_deref().unwrap_or("none given")
        )?;
        let constant = [
            ("kinetic", &protocol.constant_kinetic_columns),
            ("geometric", &protocol.constant_geometric_columns),
        ];
        for (name, columns) in constant {
            if !columns.is_empty() {
                let list: Vec<String> = columns.iter().map(usize::to_string).collect();
                let list = list.join(", ");
                writeln!(
                    text,
                    "Left out as constant in the reference: {name} columns {list}."
                )?;
            }
        }
        self.warnings
            .iter()
            .try_for_each(|warning| writeln!(text, "Note: {warning}."))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores(fid: f64, beat: Option<f64>) -> Scores {
        let mut scores = Scores::new(42, 406);
        scores.set(Metric::FidK, fid);
        if let Some(beat) = beat {
            scores.set(Metric::BeatAlign, beat);
        }
        scores
    }

    fn report(sets: Vec<Scores>) -> Report {
        let protocol = Protocol {
            clips: "windows of 300 frames every 150".into(),
            kinetic: "published",
            beats: None,
            reference_samples: 292,
            constant_kinetic_columns: vec![],
            constant_geometric_columns: vec![2, 28],
            chance_seed: 0,
        };
        Report::new(
            sets,
            scores(12.5, Some(0.2)),
            protocol,
            vec!["a word".into()],
        )
    }

    #[test]
    fn one_set_has_no_interval() {
        let report = report(vec![scores(26.0, Some(0.17))]);
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["fid_k"], 26.0);
        assert_eq!(json["beat_align"], 0.17);
        assert_eq!(json["reference"]["fid_k"], 12.5);
        assert!(json["fid_g"].is_null() && json.get("margin95").is_none());
        let text = report.markdown();
        assert!(text.contains("| FID_k ↓ | 12.500 | 26.000 |\n"), "{text}");
        assert!(text.contains("geometric columns 2, 28.") && text.ends_with("Note: a word.\n"));
    }

    #[test]
    fn several_sets_are_a_mean_with_its_margin() {
        let mut sets = vec![scores(24.0, None), scores(26.0, Some(0.1))];
        for (set, slowest) in sets.iter_mut().zip([0.3, 0.1]) {
            set.set(Metric::SlowestWindow, slowest);
        }
        let report = report(sets);
        assert_eq!(report.generated.get(Metric::FidK), Some(25.0));
        // Not known of all sets.
        assert_eq!(report.generated.get(Metric::BeatAlign), None);
        let plot = report.svg().unwrap();
        assert!(
            plot.contains("FID_k") && plot.contains("mean of 2 sets"),
            "{plot}"
        );
        assert!(
            !plot.contains("beat align"),
            "a metric without a ratio is left out"
        );
        let text = report.markdown();
        assert!(
            text.contains("| FID_k ↓ | 12.500 | 25.000 ± 12.706 |\n"),
            "{text}"
        );
        assert!(
            text.contains("| beat align score (Eq. 15) ↑ | 0.2000 | – |\n"),
            "{text}"
        );
        assert!(
            text.contains(" | 0.2000 ± 1.2706, 0.3000 at most |\n"),
            "{text}"
        );
        assert_eq!(
            serde_json::to_value(&report).unwrap()["sets"]
                .as_array()
                .unwrap()
                .len(),
            2
        );
    }
}
