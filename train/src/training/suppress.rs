//! Codes that the exported model never draws: those that bring the pelvis too near to the ground.

use bailando::{model::SuppressedCodes, motion::Positions};
use burn_flex::{Flex, FlexDevice};
use ndarray::ArrayView2;

use super::{Config, FRAMES_PER_CODE, TrainError, decode::DanceDecoder};

/// How often a code is repeated to see its pose: neighbours shape what a code is decoded to.
const REPEATS: usize = 9;

/// Lower codes whose pose has the pelvis less than `export.lowest_pelvis` metres above the lowest joint. Dancers
/// of a pair dip where the partner holds them; what only such poses are made of, a dancer alone does without.
pub(super) fn suppressed_codes(config: &Config) -> Result<SuppressedCodes, TrainError> {
    let lowest = config.export.lowest_pelvis;
    if lowest == 0.0 {
        return Ok(SuppressedCodes::default());
    }
    let decoder = DanceDecoder::<Flex>::read(config, &FlexDevice)?;
    let codes = 0..decoder.codes()[1] as i32;
    // The upper half has no say in where the pelvis is.
    let poses: Vec<_> = codes
        .map(|lower| [vec![0; REPEATS], vec![lower; REPEATS]])
        .collect();
    let dances = decoder.positions_of_many(&poses);
    let low = (0..).zip(dances).filter_map(|(code, dance)| {
        let height = pelvis_height(&dance?)?;
        (height < lowest).then_some(code)
    });
    Ok(SuppressedCodes {
        upper: Vec::new(),
        lower: low.collect(),
    })
}

/// Of the pelvis above the lowest joint, in the middle of a dance.
fn pelvis_height(dance: &Positions) -> Option<f32> {
    let middle = REPEATS / 2 * FRAMES_PER_CODE + FRAMES_PER_CODE / 2;
    let pose: ArrayView2<'_, f32> = dance.outer_iter().nth(middle)?;
    let heights = pose.column(1);
    let lowest = heights.iter().copied().fold(f32::INFINITY, f32::min);
    Some(heights.first()? - lowest)
}
