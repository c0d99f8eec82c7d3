#![doc = include_str!("../README.md")]

mod beats;
mod body;
mod bvh;
mod clips;
mod distance;
mod error;
mod files;
mod foot_contact;
mod form;
mod geometric;
mod interval;
mod kinetic;
mod load;
mod metric;
mod motion_quality;
mod music;
mod plot;
mod recitation;
mod report;
mod run;
mod scores;
mod sets;
mod skeletal;
mod study;
mod style;
#[cfg(test)]
mod testing;

pub use beats::{BeatScore, speed};
pub use body::{FRAMES_PER_SECOND, JOINTS, Motion, Pose, SkeletalMotion};
pub use bvh::{BvhFile, BvhJoint, BvhPose};
pub use clips::Clips;
pub use distance::{Standard, diversity, frechet_distance};
pub use error::EvaluationError;
pub use geometric::{GEOMETRIC_FEATURES, geometric_features};
pub use kinetic::{KINETIC_FEATURES, KineticForm, kinetic_features};
pub use load::load_motion;
pub use metric::{Metric, Scores};
pub use motion_quality::MotionQuality;
pub use music::BeatsFrom;
pub use report::{Protocol, Report, StyleRow};
pub use run::{EvaluationOptions, evaluate};
pub use scores::FeatureRows;
pub use study::{StudyOptions, StudyScore};
