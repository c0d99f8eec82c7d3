//! How a response is chosen, described and sent.

pub(crate) mod answer;
pub(crate) mod documented;
pub(crate) mod negotiate;
pub(crate) mod paced;
pub(crate) mod warnings;
