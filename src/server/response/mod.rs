//! How a response is chosen, described and sent.

mod accept;
pub(crate) mod answer;
pub(crate) mod documented;
pub(crate) mod encoding;
pub(crate) mod negotiate;
pub(crate) mod paced;
pub(crate) mod warnings;
