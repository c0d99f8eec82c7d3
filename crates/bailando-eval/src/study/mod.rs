//! The user study of the paper (section 4.2, last column of Table 1): a page that plays pairs of
//! dances to the same song side by side, and the score of what people answered.

mod page;
mod pairs;
mod score;

pub use self::{page::StudyOptions, score::StudyScore};
