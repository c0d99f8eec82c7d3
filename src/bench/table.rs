//! The figures of a bench as Markdown tables.

use super::{
    baseline::Baseline,
    report::{Bench, Machine, ThreadSteps},
};
use crate::model::WeightStorage;

impl Bench {
    /// Writes Markdown tables, with ratios to the baseline's figures.
    #[must_use]
    pub fn markdown(&self, baseline: &Baseline) -> String {
        let parts = [
            self.machine_line(),
            self.stage_table(baseline),
            self.step_table(baseline),
            self.throughput_line(),
            self.load_table(),
            self.length_table(),
            self.memory_line(),
        ];
        parts.join("\n\n") + "\n"
    }

    fn machine_line(&self) -> String {
        let Machine { cpu, vectors, cores, system } = &self.machine;
        let weights = match self.weights {
            WeightStorage::F32 => "f32",
            WeightStorage::F16 => "f16, computed as f32",
            WeightStorage::Int8 => "int8",
        };
        let (vectors, model, threads) = (vectors.join(", "), &self.model, self.threads);
        let device = &self.device;
        format!(
            "{cores} cores of {cpu} ({vectors}), {system}; model {model} ({weights}), \
             on {device}, {threads} threads a step"
        )
    }

    fn stage_table(&self, baseline: &Baseline) -> String {
        let rows = self.stages.iter().map(|stage| {
            let seconds = stage.seconds;
            let ratio = baseline
                .stage(&stage.name)
                .map(|other| format!("{:.1} x faster than {other:.2} s", other / seconds));
            let name = stage.name.clone();
            vec![
                name,
                stage.threads.to_string(),
                format!("{seconds:.3}"),
                ratio.unwrap_or_default(),
            ]
        });
        let start = vec![
            "start to ready".into(),
            self.threads.to_string(),
            format!("{:.2}", self.start_s),
            String::new(),
        ];
        table(&["stage", "threads", "seconds", "baseline"], rows.chain([start]))
    }

    fn step_table(&self, baseline: &Baseline) -> String {
        let ms = |seconds: f64| format!("{:.2}", 1e3 * seconds);
        let row = |title: String, cell: &dyn Fn(&ThreadSteps) -> String| {
            let cells = self.steps.iter().map(cell);
            std::iter::once(title).chain(cells).collect::<Vec<_>>()
        };
        let mut rows = vec![row("reading the weights once".into(), &|steps| {
            format!("{} ({:.0} MB)", ms(steps.floor_s), steps.weight_bytes as f64 / 1e6)
        })];
        let batches = self.steps.first().map_or(&[][..], |steps| &steps.steps);
        for (place, point) in batches.iter().enumerate() {
            rows.push(row(format!("{} at once", point.batch), &|steps| {
                let seconds = steps.steps[place].seconds;
                match place {
                    0 => format!("{} ({:.2} x reading)", ms(seconds), seconds / steps.floor_s),
                    _ => ms(seconds),
                }
            }));
        }
        rows.push(row("prefill".into(), &|steps| {
            let ratio = steps.prefill_s / steps.steps[0].seconds;
            let (time, count) = (ms(steps.prefill_s), steps.prefill_steps);
            format!("{time} ({count} steps, {ratio:.1} x a step)")
        }));
        rows.push(row("a code, prefills included".into(), &|steps| {
            let ratio = baseline
                .code_s(steps.threads)
                .map(|other| format!(", {:.1} x faster than {}", other / steps.code_s, ms(other)));
            let ratio = ratio.unwrap_or_default();
            format!("{} (hop {}){ratio}", ms(steps.code_s), steps.hop)
        }));
        let head = row("step of the GPT, milliseconds".into(), &|steps| {
            format!("{} threads", steps.threads)
        });
        table(&head, rows)
    }

    fn throughput_line(&self) -> String {
        let all = &self.throughput;
        let (alone, at_once) = (all.one_after_another_s, all.at_once_s);
        format!(
            "{} dances of {} codes in all: {alone:.2} s one after another, {at_once:.2} s at once \
             ({:.2} x), {} codes",
            all.dances,
            all.codes,
            alone / at_once,
            if all.same_codes { "the same" } else { "OTHER" }
        )
    }

    fn load_table(&self) -> String {
        let rows = self.load.iter().map(|point| {
            let figures = [point.dances_per_second, point.p50_s, point.p95_s, point.p99_s];
            let figures = figures.map(|figure| format!("{figure:.2}"));
            std::iter::once(point.callers.to_string()).chain(figures).collect()
        });
        table(&["callers", "dances a second", "p50 s", "p95 s", "p99 s"], rows)
    }

    fn length_table(&self) -> String {
        let first = self.lengths.first().map_or(f64::NAN, |point| point.elapsed_s);
        let rows = self.lengths.iter().map(|point| {
            vec![
                format!("{:.0}", point.seconds),
                format!("{:.2}", point.elapsed_s),
                format!("{:.2}", point.elapsed_s / first),
                megabytes(point.resident_peak_bytes),
            ]
        });
        table(&["song, s", "seconds", "x the first", "peak memory so far, MB"], rows)
    }

    fn memory_line(&self) -> String {
        format!(
            "Memory in MB: {} before the model is loaded, {} idle, {} at most",
            megabytes(self.resident_before_start_bytes),
            megabytes(self.resident_idle_bytes),
            megabytes(self.resident_peak_bytes)
        )
    }
}

fn megabytes(bytes: Option<u64>) -> String {
    bytes.map_or("?".into(), |bytes| format!("{:.0}", bytes as f64 / 1e6))
}

fn table(head: &[impl AsRef<str>], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let head: Vec<&str> = head.iter().map(AsRef::as_ref).collect();
    let mut text = format!("| {} |\n|{}", head.join(" | "), "---|".repeat(head.len()));
    for row in rows {
        text += &format!("\n| {} |", row.join(" | "));
    }
    text
}
