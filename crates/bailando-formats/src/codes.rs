//! Pose codes of a motion.

use serde::Serialize;

/// Pose codes of the two half bodies, one pair per 8 frames at 60 fps.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Codes {
    /// Upper half of the body.
    pub upper: Vec<u32>,
    /// Lower half of the body.
    pub lower: Vec<u32>,
}
