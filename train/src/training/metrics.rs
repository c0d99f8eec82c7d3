//! `metrics.csv`: only what depends on settings and seed, so that runs can be compared by bytes.

use std::{
    collections::BTreeMap,
    fs,
    io::Write,
    path::{Path, PathBuf},
};

use super::{
    error::TrainError,
    files::{if_present, replace_file},
};

/// The file of a running stage.
pub(super) struct Metrics {
    path: PathBuf,
    file: fs::File,
    test_columns: usize,
}

impl Metrics {
    /// Opens the file, or starts one. Lines beyond `step` are of a run that was killed after its
    /// checkpoint: they are taken off.
    ///
    /// # Errors
    /// [`TrainError::File`] for anything but a missing file: metrics that cannot be read are not
    /// replaced.
    pub(super) fn open(
        path: PathBuf,
        columns: &[&str],
        test_columns: &[&str],
        step: u64,
    ) -> Result<Self, TrainError> {
        let old = if_present(fs::read_to_string(&path)).map_err(TrainError::file(&path))?;
        let old = old.as_deref().unwrap_or("");
        let names = [&["step", "rate"], columns, test_columns].concat();
        let mut text = format!("{}\n", names.join(","));
        let whole = |line: &&str| line.ends_with('\n') && step_of(line).is_some_and(|n| n <= step);
        text.extend(old.split_inclusive('\n').skip(1).take_while(whole));
        if text != old {
            replace_file(&path, text.as_bytes()).map_err(TrainError::file(&path))?;
        }
        let file = fs::OpenOptions::new().append(true).open(&path);
        let file = file.map_err(TrainError::file(&path))?;
        Ok(Self { path, file, test_columns: test_columns.len() })
    }

    /// Appends a line; columns of the test split stay empty where it was not measured.
    pub(super) fn append(
        &mut self,
        step: u64,
        rate: f64,
        means: &[f32],
        tests: Option<&[f32]>,
    ) -> Result<(), TrainError> {
        let mut line = format!("{step},{rate:e}");
        for mean in means {
            line.push_str(&format!(",{mean}"));
        }
        for column in 0..self.test_columns {
            let value = tests.and_then(|tests| tests.get(column));
            line.push_str(&value.map_or(",".to_owned(), |value| format!(",{value}")));
        }
        line.push('\n');
        self.file.write_all(line.as_bytes()).map_err(TrainError::file(&self.path))
    }

    pub(super) fn sync(&mut self) -> Result<(), TrainError> {
        self.file.sync_data().map_err(TrainError::file(&self.path))
    }
}

fn step_of(line: &str) -> Option<u64> {
    line.split(',').next()?.parse().ok()
}

/// Reads the measured points of every column, by step.
pub(super) fn read_series(path: &Path) -> Result<BTreeMap<String, Vec<(u64, f64)>>, TrainError> {
    let text = fs::read_to_string(path).map_err(TrainError::file(path))?;
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap_or("").split(',').collect();
    let mut series: BTreeMap<String, Vec<(u64, f64)>> = BTreeMap::new();
    for line in lines {
        let Some(step) = step_of(line) else { continue };
        for (name, value) in names.iter().zip(line.split(',')).skip(1) {
            if let Ok(value) = value.parse() {
                series.entry((*name).to_owned()).or_default().push((step, value));
            }
        }
    }
    Ok(series)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_that_cannot_be_read_are_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.csv");
        let bytes = b"step,rate,loss\n10,5e-1,\xff\n";
        fs::write(&path, bytes).unwrap();
        let refused = Metrics::open(path.clone(), &["loss"], &[], 20).err().unwrap();
        assert!(matches!(refused, TrainError::File { .. }), "{refused}");
        assert_eq!(fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn lines_after_the_checkpoint_and_torn_lines_go() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.csv");
        let open = |step| Metrics::open(path.clone(), &["loss"], &["test_loss"], step).unwrap();
        let mut metrics = open(0);
        metrics.append(10, 0.5, &[3.5], None).unwrap();
        metrics.append(20, 0.5, &[2.5], Some(&[4.25])).unwrap();
        metrics.append(30, 0.5, &[1.5], None).unwrap();
        // The beginning of step 100: its number alone looks like an early one.
        fs::OpenOptions::new().append(true).open(&path).unwrap().write_all(b"10").unwrap();
        open(100);
        let text = fs::read_to_string(&path).unwrap();
        let wanted = "step,rate,loss,test_loss\n10,5e-1,3.5,\n20,5e-1,2.5,4.25\n30,5e-1,1.5,\n";
        assert_eq!(text, wanted);
        open(20);
        let series = read_series(&path).unwrap();
        assert_eq!(series["loss"], [(10, 3.5), (20, 2.5)]);
        assert_eq!(series["test_loss"], [(20, 4.25)]);
    }
}
