//! AMASS: rotations of SMPL-H or SMPL-X in a NumPy archive, z up. The root's path is that of the
//! model's origin, a constant way from the pelvis: standing on the floor makes up for its height.

use std::{
    io::{Cursor, Read},
    path::Path,
};

use zip::ZipArchive;

use super::{
    super::{DataError, body::BodyPoses, files, npy},
    recorded::Recorded,
};

/// An hour of SMPL-X at 120 frames a second has 0.6 GB in float64; the longest of AMASS 0.1 GB.
const MAX_BYTES: u64 = 1 << 30;

pub(super) fn read(path: &Path) -> Result<Recorded, DataError> {
    let bytes = files::read_at_most(path, MAX_BYTES)?;
    parse(bytes).map_err(|what| DataError::Shape { path: path.to_owned(), what })
}

type Archive = ZipArchive<Cursor<Vec<u8>>>;

fn parse(bytes: Vec<u8>) -> Result<Recorded, String> {
    let mut archive = ZipArchive::new(Cursor::new(bytes))
        .map_err(|error| format!("this is no NumPy archive: {error}"))?;
    let rate = match array(&mut archive, &["mocap_framerate", "mocap_frame_rate"])?.1.as_slice() {
        &[rate] => f64::from(rate),
        values => return Err(format!("mocap_framerate has {} values", values.len())),
    };
    let body = BodyPoses {
        poses: array(&mut archive, &["poses"])?,
        path: array(&mut archive, &["trans"])?,
        scaling: None,
    };
    Ok(Recorded { animation: body.animation()?, rate })
}

/// The first of these arrays that is there.
fn array(archive: &mut Archive, keys: &[&str]) -> Result<(Vec<usize>, Vec<f32>), String> {
    let found = keys.iter().map(|key| format!("{key}.npy"));
    let found = found.into_iter().find(|name| archive.index_for_name(name).is_some());
    let name = found.ok_or_else(|| format!("there is no array `{}` in it", keys.join("` or `")))?;
    let entry = archive.by_name(&name).map_err(|error| format!("{name}: {error}"))?;
    let mut bytes = Vec::new();
    let read = entry.take(MAX_BYTES + 1).read_to_end(&mut bytes);
    read.map_err(|error| format!("{name}: {error}"))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(format!("{name} has more than {MAX_BYTES} bytes"));
    }
    let array = npy::array(&bytes, true).map_err(|what| format!("{name}: {what}"))?;
    Ok((array.shape, array.values))
}
