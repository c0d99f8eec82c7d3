//! Form of a song: which phrases return after something else.
//!
//! A song's phrases, or bars, are compared by timbre and harmony count by count ([`Phrases`],
//! [`SelfSimilarity`]); what returns shows as a stripe beside the diagonal of their self-similarity
//! (Foote 1999, Goto 2003).

mod phrases;
mod returns;
mod similarity;

pub use self::{
    phrases::Phrases,
    returns::{Return, returns},
    similarity::SelfSimilarity,
};
