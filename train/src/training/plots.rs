//! The curves of a stage as SVG files beside its metrics.

use std::{
    collections::BTreeMap,
    io::Write,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use super::{
    chart::{Chart, Line, draw},
    files::replace_file,
    metrics::read_series,
};

/// Plots follow the checkpoints, but not more often than this.
const PAUSE: Duration = Duration::from_secs(60);

/// One file.
struct Plot {
    file: &'static str,
    /// One below the other.
    panels: &'static [Panel],
}

struct Panel {
    title: &'static str,
    /// Names as in the header of `metrics.csv`; those that a stage does not have are left out.
    columns: &'static [&'static str],
}

/// A stage gets the plots for which it has a column.
const PLOTS: [Plot; 3] = [
    Plot { file: "loss.svg", panels: &[Panel { title: "loss", columns: &["loss", "test_loss"] }] },
    Plot {
        file: "codebook.svg",
        panels: &[
            Panel {
                title: "perplexity of the codes",
                columns: &["upper_perplexity", "lower_perplexity"],
            },
            Panel {
                title: "restarted entries a step",
                columns: &["upper_restarts", "lower_restarts"],
            },
        ],
    },
    Plot {
        file: "reward.svg",
        panels: &[
            Panel {
                title: "mean reward of a code",
                columns: &["reward", "beat_reward", "consistency"],
            },
            Panel { title: "entropy of the policy", columns: &["entropy"] },
        ],
    },
];

/// Draws the plots of a running stage.
pub(super) struct Plots {
    folder: PathBuf,
    stage: &'static str,
    drawn: Instant,
}

impl Plots {
    pub(super) fn new(folder: PathBuf, stage: &'static str) -> Self {
        Self { folder, stage, drawn: Instant::now() }
    }

    /// Draws what `metrics.csv` holds, if it is time or `now`. A plot that fails is no reason to
    /// stop: it is a line on `output`.
    pub(super) fn draw(&mut self, now: bool, output: &mut impl Write) {
        if !now && self.drawn.elapsed() < PAUSE {
            return;
        }
        self.drawn = Instant::now();
        if let Err(message) = draw_all(&self.folder, self.stage) {
            let _ = writeln!(output, "warning: no plots of {}: {message}", self.stage);
        }
    }
}

fn draw_all(folder: &Path, stage: &str) -> Result<(), String> {
    let series = read_series(&folder.join("metrics.csv")).map_err(|error| error.to_string())?;
    for plot in &PLOTS {
        let charts: Vec<Chart<'_>> = plot
            .panels
            .iter()
            .map(|panel| chart(panel, stage, &series))
            .filter(|chart| !chart.lines.is_empty())
            .collect();
        if charts.is_empty() {
            continue;
        }
        let path = folder.join(plot.file);
        let svg = draw(&charts)?;
        replace_file(&path, svg.as_bytes())
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(())
}

fn chart<'a>(
    panel: &Panel,
    stage: &str,
    series: &'a BTreeMap<String, Vec<(u64, f64)>>,
) -> Chart<'a> {
    let lines = panel.columns.iter().filter_map(|&column| {
        let points = series.get(column)?;
        Some(Line { label: column, points })
    });
    Chart { title: format!("{stage}: {}", panel.title), lines: lines.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(metrics: &str) -> (Vec<String>, String) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("metrics.csv"), metrics).unwrap();
        let mut output = Vec::new();
        let mut plots = Plots::new(folder.path().to_owned(), "vqvae");
        plots.draw(false, &mut output);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        plots.draw(true, &mut output);
        let entries = std::fs::read_dir(folder.path()).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        (names, String::from_utf8(output).unwrap())
    }

    #[test]
    fn a_stage_gets_the_plots_that_it_has_columns_for() {
        let (names, output) = drawn("step,rate,loss\n10,1,0.5\n");
        assert_eq!(names, ["loss.svg", "metrics.csv"]);
        let (names, _) = drawn("step,rate,loss,upper_restarts\n10,1,0.5,2\n20,1,0.25,0\n");
        assert_eq!(names, ["codebook.svg", "loss.svg", "metrics.csv"]);
        assert_eq!(output, "");
    }

    #[test]
    fn a_plot_that_fails_is_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        let mut output = Vec::new();
        Plots::new(folder.path().to_owned(), "gpt").draw(true, &mut output);
        let output = String::from_utf8(output).unwrap();
        assert!(output.starts_with("warning: no plots of gpt: "), "{output}");
    }
}
