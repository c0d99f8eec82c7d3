//! Pose codes from files.

use std::path::Path;

use anyhow::Context;
use bailando::{formats::Codes, npy::read_array};
use ndarray::Array2;

use super::console::read_file;

/// What a NumPy file begins with.
const NUMPY: &[u8] = b"\x93NUMPY";

/// Reads codes as a dance's JSON has them, or int64 [2, codes] as `--codes-out` writes them.
pub(super) fn read_codes(path: &Path) -> anyhow::Result<Codes> {
    let bytes = read_file(path)?;
    let codes = match bytes.starts_with(NUMPY) {
        true => of_array(&bytes),
        false => String::from_utf8(bytes).map_err(Into::into).and_then(|text| Ok(text.parse()?)),
    };
    codes.with_context(|| path.display().to_string())
}

fn of_array(bytes: &[u8]) -> anyhow::Result<Codes> {
    let problem = "not int64 codes, upper and lower";
    let rows: Array2<i64> = read_array(bytes).context(problem)?;
    anyhow::ensure!(rows.nrows() == 2, problem);
    let row = |row: usize| {
        let codes = rows.row(row).into_iter().map(|&code| u32::try_from(code));
        codes.collect::<Result<Vec<u32>, _>>().context(problem)
    };
    Ok(Codes { upper: row(0)?, lower: row(1)? })
}
