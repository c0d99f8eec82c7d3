//! Audio files to mono PCM at the rates the features need; limits are enforced while decoding.
//!
//! A song goes one way through the files of this crate: `sniff` detects the container, `headers`
//! checks what it declares, `demux` reads packets, `codec` decodes them, `downmix` mixes the
//! channels, `gapless` trims the encoder's delay, `sink` cuts the wanted range, `resample`
//! converts the rate.
//!
//! ```
//! use bailando_audio::{AudioLimits, AudioRange, decode};
//! use bailando_core::CancelToken;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // One second of a square wave of 400 Hz: stereo, 16 bits, 8 kHz.
//! let samples = (0..8_000).flat_map(|i| [if i % 20 < 10 { 8_192_i16 } else { -8_192 }; 2]);
//! let song = bailando_testkit::wav::wav16(2, 8_000, &samples.collect::<Vec<_>>());
//!
//! let part = AudioRange {
//!     offset_s: 0.25,
//!     duration_s: Some(0.5),
//! };
//! let limits = AudioLimits::default();
//! let audio = decode(song.into(), part, &[8_000, 3_840], &limits, &CancelToken::new())?;
//! assert_eq!(audio.duration_s, 0.5);
//! assert_eq!(audio.signals[0][..2], [0.25, 0.25]);
//! assert_eq!(audio.signals[1].len(), 1_920);
//! # Ok(())
//! # }
//! ```

mod codec;
mod container;
mod decode;
mod demux;
mod downmix;
mod ebml;
mod error;
mod flac;
#[doc(hidden)]
pub mod fuzzing;
mod gapless;
mod headers;
mod id3;
mod kernel;
mod limits;
mod mp3;
mod mp4;
mod mp4_tables;
mod mpeg;
mod ogg;
mod ogg_page;
mod opus;
mod outputs;
mod packets;
mod resample;
mod riff;
mod rope;
mod sink;
mod sniff;
mod upload;
mod vorbis;
mod webm;

pub use container::{Container, FORMATS};
pub use decode::decode;
pub use error::AudioError;
pub use limits::{AudioLimits, AudioRange};
pub use resample::{Resampler, resample};
pub use sink::DecodedAudio;
pub use sniff::is_lossless;
