//! How a response is chosen, described and sent.

pub(crate) mod documented;
pub(crate) mod idle_body;
pub(crate) mod negotiate;
pub(crate) mod warnings;
