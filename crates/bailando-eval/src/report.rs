//! The result of an evaluation, as JSON or as a Markdown table.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write,
};

use serde::Serialize;

use crate::{
    interval::mean_and_margin,
    metric::{Metric, Scores, Wanted},
};

/// The measuring of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Protocol {
    /// The parts of a motion that are samples, in words.
    pub clips: String,
    /// `published` or `corrected` (not comparable with published figures).
    pub kinetic: &'static str,
    /// The source of the music beats, in words; none: there are none.
    pub beats: Option<&'static str>,
    /// Samples of the reference.
    pub reference_samples: usize,
    /// Kinetic columns left out because they are constant in the reference.
    pub constant_kinetic_columns: Vec<usize>,
    /// Geometric columns left out because they are constant in the reference.
    pub constant_geometric_columns: Vec<usize>,
    /// Seed of the random shifts behind the chance level.
    pub chance_seed: u64,
}

/// The result of an evaluation.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Generated motions; with several sets, the mean of each metric.
    #[serde(flatten)]
    pub generated: Scores,
    /// Half the width of the 95 % confidence interval of the mean over the sets, by metric; empty
    /// for one set.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub margin95: BTreeMap<&'static str, f64>,
    /// Each set alone, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sets: Vec<Scores>,
    /// The reference's own test pieces against the whole reference.
    pub reference: Scores,
    /// What a few pieces are enough to measure, for each style; empty where styles are not
    /// recognised.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub styles: BTreeMap<String, StyleRow>,
    /// The measuring.
    pub protocol: Protocol,
    /// Facts to know before comparing, in plain words.
    pub warnings: Vec<String>,
}

/// Scores of one style.
#[derive(Clone, Debug, Serialize)]
pub struct StyleRow {
    /// The reference's own test pieces of this style; none where it has none.
    pub reference: Option<Scores>,
    /// Generated motions of this style; with several sets, the mean of each metric.
    pub generated: Option<Scores>,
}

/// The columns of the table of styles.
const STYLE_COLUMNS: [Metric; 7] = [
    Metric::StyleAccuracy,
    Metric::BeatMargin,
    Metric::MeanSpeed,
    Metric::SlowFrames,
    Metric::Jerk,
    Metric::FootSkate,
    Metric::FootContact,
];

impl Report {
    /// Takes the scores of one or more generated sets, each from another seed.
    pub(crate) fn new(
        sets: Vec<Scores>,
        reference: Scores,
        protocol: Protocol,
        warnings: Vec<String>,
    ) -> Self {
        let (generated, margin95) = mean_of(&sets);
        Self {
            styles: BTreeMap::new(),
            generated,
            margin95,
            sets: if sets.len() > 1 { sets } else { Vec::new() },
            reference,
            protocol,
            warnings,
        }
    }

    /// Adds the scores of each style: of the reference, and of every generated set.
    pub(crate) fn add_styles(
        &mut self,
        mut reference: BTreeMap<String, Scores>,
        sets: Vec<BTreeMap<String, Scores>>,
    ) {
        let mut generated: BTreeMap<String, Vec<Scores>> = BTreeMap::new();
        for (style, scores) in sets.into_iter().flatten() {
            generated.entry(style).or_default().push(scores);
        }
        let names = reference.keys().chain(generated.keys()).cloned();
        for style in names.collect::<BTreeSet<String>>() {
            let row = StyleRow {
                reference: reference.remove(&style),
                generated: generated.get(&style).map(|sets| mean_of(sets).0),
            };
            self.styles.insert(style, row);
        }
    }

    /// Writes a Markdown table, one metric a row, and the measuring below it.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut text = String::new();
        // Writing to a string can't fail.
        let _ = self
            .table(&mut text)
            .and_then(|()| self.style_table(&mut text))
            .and_then(|()| self.notes(&mut text));
        text
    }

    fn table(&self, text: &mut String) -> std::fmt::Result {
        let generated = match self.sets.len() {
            0 => "generated".to_owned(),
            sets => format!("generated, {sets} sets (± 95 %)"),
        };
        writeln!(text, "| metric | reference | {generated} |\n|---|---|---|")?;
        let [reference, generated] = [&self.reference, &self.generated];
        writeln!(text, "| pieces | {} | {} |", reference.pieces, generated.pieces)?;
        writeln!(text, "| samples | {} | {} |", reference.samples, generated.samples)?;
        let all = [reference, generated];
        Metric::all()
            .filter(|&metric| all.iter().any(|scores| scores.get(metric).is_some()))
            .try_for_each(|metric| self.row(text, metric))
    }

    /// One style a row, generated values before the reference's.
    fn style_table(&self, text: &mut String) -> std::fmt::Result {
        if self.styles.is_empty() {
            return Ok(());
        }
        let titles = STYLE_COLUMNS.map(Metric::title).join(" | ");
        writeln!(text, "\n| style, generated (reference) | pieces | {titles} |")?;
        writeln!(text, "|---|---|{}", "---|".repeat(STYLE_COLUMNS.len()))?;
        for (style, row) in &self.styles {
            let value = |scores: &Option<Scores>, metric: Metric| {
                let value = scores.as_ref().and_then(|scores| scores.get(metric));
                let decimals = metric.decimals();
                value.map_or("–".into(), |value| format!("{value:.decimals$}"))
            };
            let pieces =
                |scores: &Option<Scores>| scores.as_ref().map_or(0, |scores| scores.pieces);
            write!(text, "| {style} | {} ({}) |", pieces(&row.generated), pieces(&row.reference))?;
            for metric in STYLE_COLUMNS {
                let [generated, reference] =
                    [&row.generated, &row.reference].map(|scores| value(scores, metric));
                write!(text, " {generated} ({reference}) |")?;
            }
            writeln!(text)?;
        }
        Ok(())
    }

    fn row(&self, text: &mut String, metric: Metric) -> std::fmt::Result {
        let (title, decimals) = (metric.title(), metric.decimals());
        let wanted = match metric.wanted() {
            Wanted::Low => " ↓",
            Wanted::High => " ↑",
            Wanted::Alike => "",
        };
        let [reference, generated] = [&self.reference, &self.generated].map(|scores| {
            let value = scores.get(metric);
            value.map_or("–".into(), |value| format!("{value:.decimals$}"))
        });
        write!(text, "| {title}{wanted} | {reference} | {generated}")?;
        if let Some(margin) = self.margin95.get(metric.key()) {
            write!(text, " ± {margin:.decimals$}")?;
        }
        // This metric is about the worst case, which a mean over the sets would hide.
        let largest = self.sets.iter().filter_map(|set| set.get(metric));
        match largest.reduce(f64::max) {
            Some(largest) if metric == Metric::SlowestWindow => {
                writeln!(text, ", {largest:.decimals$} at most |")
            }
            _ => writeln!(text, " |"),
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
            protocol.beats.unwrap_or("none given")
        )?;
        for (name, columns) in [
            ("kinetic", &protocol.constant_kinetic_columns),
            ("geometric", &protocol.constant_geometric_columns),
        ] {
            if !columns.is_empty() {
                let columns: Vec<String> = columns.iter().map(usize::to_string).collect();
                let columns = columns.join(", ");
                let left_out = "Left out as constant in the reference";
                writeln!(text, "{left_out}: {name} columns {columns}.")?;
            }
        }
        self.warnings.iter().try_for_each(|warning| writeln!(text, "Note: {warning}."))
    }
}

/// The mean of each metric over some sets that all have it, and half the width of its 95 %
/// interval.
fn mean_of(sets: &[Scores]) -> (Scores, BTreeMap<&'static str, f64>) {
    let count = |get: fn(&Scores) -> usize| sets.iter().map(get).max().unwrap_or(0);
    let mut scores = Scores::new(count(|set| set.pieces), count(|set| set.samples));
    let mut margins = BTreeMap::new();
    for metric in Metric::all() {
        let values: Vec<f64> = sets.iter().filter_map(|set| set.get(metric)).collect();
        // A mean over some of the sets would be compared with one over all.
        if values.len() != sets.len() {
            continue;
        }
        if let Some((mean, margin)) = mean_and_margin(&values) {
            scores.set(metric, mean);
            margins.extend(margin.map(|margin| (metric.key(), margin)));
        }
    }
    (scores, margins)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores(values: &[(Metric, f64)]) -> Scores {
        let mut scores = Scores::new(42, 406);
        for &(metric, value) in values {
            scores.set(metric, value);
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
        let reference = scores(&[(Metric::FidK, 12.5), (Metric::BeatAlign, 0.2)]);
        Report::new(sets, reference, protocol, vec!["a word".into()])
    }

    fn assert_contains(text: &str, lines: &[&str]) {
        for line in lines {
            assert!(text.contains(line), "{line} in {text}");
        }
    }

    #[test]
    fn one_set_has_no_interval() {
        let set = scores(&[(Metric::FidK, 26.0), (Metric::BeatAlign, 0.17)]);
        let report = report(vec![set]);
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["fid_k"], 26.0);
        assert_eq!(json["beat_align"], 0.17);
        assert_eq!(json["reference"]["fid_k"], 12.5);
        assert!(json["fid_g"].is_null() && json.get("margin95").is_none());
        let text = report.markdown();
        let row = "| FID_k ↓ | 12.500 | 26.000 |\n";
        assert_contains(&text, &[row, "geometric columns 2, 28."]);
        assert!(text.ends_with("Note: a word.\n"));
    }

    #[test]
    fn several_sets_are_a_mean_with_its_margin() {
        let slowest = Metric::SlowestWindow;
        let report = report(vec![
            scores(&[(Metric::FidK, 24.0), (slowest, 0.3)]),
            scores(&[(Metric::FidK, 26.0), (slowest, 0.1), (Metric::BeatAlign, 0.1)]),
        ]);
        assert_eq!(report.generated.get(Metric::FidK), Some(25.0));
        // Not known of all sets.
        assert_eq!(report.generated.get(Metric::BeatAlign), None);
        let plot = report.svg().unwrap();
        assert_contains(&plot, &["FID_k", "mean of 2 sets"]);
        let has_ratio = plot.contains("beat align");
        assert!(!has_ratio, "a metric without a ratio is left out");
        let rows = [
            "| FID_k ↓ | 12.500 | 25.000 ± 12.706 |\n",
            "| beat align score (Eq. 15) ↑ | 0.2000 | – |\n",
            " | 0.2000 ± 1.2706, 0.3000 at most |\n",
        ];
        assert_contains(&report.markdown(), &rows);
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["sets"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn styles_have_a_row_each_with_the_mean_over_sets() {
        let row = |accuracy| scores(&[(Metric::StyleAccuracy, accuracy), (Metric::Jerk, 9.0)]);
        let styles = |rows: &[(&str, f64)]| {
            rows.iter().map(|&(style, accuracy)| (style.to_owned(), row(accuracy))).collect()
        };
        let mut report = report(vec![scores(&[]), scores(&[])]);
        let sets = vec![styles(&[("pop", 0.5), ("lock", 0.2)]), styles(&[("pop", 0.7)])];
        report.add_styles(styles(&[("pop", 1.0)]), sets);
        let rows = ["| pop | 42 (42) | 0.600 (1.000) | – (–) |", "| lock | 42 (0) | 0.200 (–) |"];
        assert_contains(&report.markdown(), &rows);
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["styles"]["pop"]["generated"]["style_accuracy"], 0.6);
        assert!(json["styles"]["lock"]["reference"].is_null());
    }
}
