//! Codes that the exported model never draws: those with the pelvis too near to the ground.

use bailando::{model::SuppressedCodes, motion::Positions};
use burn_flex::{Flex, FlexDevice};
use ndarray::ArrayView2;

use super::{config::Config, decode::MotionDecoder, error::TrainError};
use crate::data::FRAMES_PER_CODE;

/// Repetitions of a code that show its pose: a code's neighbours change its frames.
const REPEATS: usize = 9;

/// Finds the lower codes whose pose has the pelvis less than `export.lowest_pelvis` metres above
/// the lowest joint. Dancers of a pair dip where the partner holds them; a dancer alone cannot.
pub(super) fn suppressed_codes(config: &Config) -> Result<SuppressedCodes, TrainError> {
    let lowest = config.export.lowest_pelvis;
    if lowest == 0.0 {
        return Ok(SuppressedCodes::default());
    }
    let decoder = MotionDecoder::<Flex>::read(config, &FlexDevice)?;
    let codes = 0..decoder.codes()[1] as i32;
    // The upper half does not move the pelvis.
    let poses: Vec<_> = codes.map(|lower| [vec![0; REPEATS], vec![lower; REPEATS]]).collect();
    let motions = decoder.positions_of_many(&poses);
    let low = (0..).zip(motions).filter_map(|(code, motion)| {
        let height = pelvis_height(&motion?)?;
        (height < lowest).then_some(code)
    });
    Ok(SuppressedCodes { upper: Vec::new(), lower: low.collect() })
}

/// Returns the height of the pelvis above the lowest joint in the middle of a motion.
fn pelvis_height(motion: &Positions) -> Option<f32> {
    let middle = REPEATS / 2 * FRAMES_PER_CODE + FRAMES_PER_CODE / 2;
    let pose: ArrayView2<'_, f32> = motion.outer_iter().nth(middle)?;
    let heights = pose.column(1);
    let lowest = heights.iter().copied().fold(f32::INFINITY, f32::min);
    Some(heights.first()? - lowest)
}
