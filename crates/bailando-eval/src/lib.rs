//! How good are generated dances? Distances to recordings as published tables compute them
//! (METRICS.md; paper section 4), and beside them what those figures hide.
//!
//! [`evaluate`] goes from folders to a [`Report`]. Every metric is also there by itself: joints
//! `[frames, 24, 3]` in metres, y up, at 60 frames a second ([`Motion`]), computed in doubles.

mod beats;
mod body;
mod clips;
mod distance;
mod error;
mod geometric;
mod interval;
mod kinetic;
mod load;
mod metric;
mod motion_quality;
mod music;
mod plot;
mod recitation;
mod reference;
mod report;
mod run;
mod scores;

pub use beats::{BeatScore, speed};
pub use body::{FRAMES_PER_SECOND, JOINT_NAMES, JOINTS, Motion, Pose, SHORTEST_MOTION};
pub use clips::{Clips, PUBLISHED_FRAMES};
pub use distance::{Standard, diversity, frechet_distance};
pub use error::EvaluationError;
pub use geometric::{GEOMETRIC_FEATURES, geometric_features};
pub use interval::mean_and_margin;
pub use kinetic::{KINETIC_FEATURES, KineticForm, kinetic_features};
pub use load::{load_motion, motion_files};
pub use metric::{Metric, Scores, Wanted};
pub use motion_quality::MotionQuality;
pub use music::{BeatSource, MusicBeats};
pub use recitation::Repertoire;
pub use reference::{DanceSet, Piece, Reference, TEST_SPLIT};
pub use report::{Protocol, Report};
pub use run::{BeatsFrom, EvaluationOptions, evaluate};
pub use scores::{FeatureRows, Judge, Ruler};
