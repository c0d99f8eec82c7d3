//! Which style a dance looks like: a classifier of motion windows that training recordings teach.

mod discriminant;
mod recognition;
mod window;

pub(crate) use recognition::StyleRecognition;
