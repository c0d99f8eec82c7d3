//! Beats, bars and metre of a song: a network's activations, and the likeliest beats after them.
//!
//! After BEATS: `spectrogram` and `filterbank` make the rows that the network reads, `hmm` and
//! `decode` find the beats, `octave` and `bars` correct what the network cannot know, `tempo` draws
//! a line through them, `counts` makes the dancer's counts of them.

mod bars;
pub(crate) mod counts;
mod decode;
mod filterbank;
#[cfg(test)]
mod golden_tests;
mod hmm;
mod octave;
mod song;
mod spectrogram;
mod tempo;
mod tracker;

pub use song::SongBeats;
pub use tracker::BeatFinder;
