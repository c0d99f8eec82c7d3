//! BVH of any known rig: its joints' places, brought to our size, then rotations of our skeleton
//! that point its bones the same way.

use std::path::Path;

use bailando::{
    evaluation::BvhFile,
    motion::{InverseKinematics, Positions, Skeleton},
};

use super::{
    super::{DataError, JOINTS, files, load::broken_frame},
    recorded::Recorded,
    rig::Rig,
};

/// An hour of 60 joints at 120 frames a second has 0.7 GB.
const MAX_BYTES: u64 = 1 << 30;

pub(super) fn read(path: &Path, skeleton: &Skeleton) -> Result<Recorded, DataError> {
    let shape = |what: String| DataError::Shape { path: path.to_owned(), what };
    let bytes = files::read_at_most(path, MAX_BYTES)?;
    let text = String::from_utf8_lossy(&bytes);
    let file = BvhFile::parse(text.trim_start_matches('\u{feff}')).map_err(shape)?;
    let positions = positions(&file, skeleton).map_err(shape)?;
    if let Some(frame) = broken_frame(&positions) {
        return Err(DataError::NotFinite { path: path.to_owned(), frame });
    }
    let rate = file.frames_per_second;
    let motion = |source| DataError::Motion { path: path.to_owned(), source };
    let solver = InverseKinematics::new(skeleton).map_err(motion)?;
    let animation = solver.solve(&positions, rate.round() as u32).map_err(motion)?;
    Ok(Recorded { animation, rate })
}

/// Joints `[frames, 24, 3]` of a figure with legs as long as ours.
fn positions(file: &BvhFile, skeleton: &Skeleton) -> Result<Positions, String> {
    let rig = Rig::recognise(file, skeleton)?;
    let ratio = rig.leg_ratio(&rig.points(&file.pose(0)));
    if !ratio.is_finite() || ratio <= 0.0 {
        return Err("its legs have no length".into());
    }
    let mut positions = Positions::zeros((file.frames(), JOINTS, 3));
    for (frame, mut pose) in positions.outer_iter_mut().enumerate() {
        let points = rig.points(&file.pose(frame));
        for (point, mut cells) in points.iter().zip(pose.outer_iter_mut()) {
            for (cell, value) in cells.iter_mut().zip((*point * ratio).to_array()) {
                *cell = value as f32;
            }
        }
    }
    Ok(positions)
}
