//! Receiving a request's body: the audio, and the options that come with it.

pub(crate) mod body;
mod form;
pub(crate) mod media;
mod receive;

pub(crate) use self::receive::{Asked, check_declared, receive};
