//! The speed of a model on this machine: the figures of `bailando bench`. No test judges them; they
//! are medians of wall-clock times of one run on a machine that should do nothing else.

mod baseline;
mod clock;
mod generator;
mod length;
mod load;
mod machine;
mod options;
mod plot;
mod report;
mod run;
mod stages;
mod steps;
mod table;

pub use baseline::Baseline;
pub use options::BenchOptions;
pub use report::{
    Bench, LengthPoint, LoadPoint, Machine, Stage, StepPoint, ThreadSteps, Throughput,
};
pub use run::run;
