//! Content codings of whole answers, which are compressed where they are written: a compressor on
//! the threads that serve connections would keep all others waiting.

use std::io::{self, Write};

use axum::http::{HeaderMap, HeaderValue, header};
use flate2::write::GzEncoder;

use crate::server::response::accept::quality_of_coding;

/// Smallest answer that is compressed, bytes.
const SMALLEST: usize = 1024;
/// Bytes that an encoder hands on at a time.
const BUFFER: usize = 64 * 1024;
/// The fastest levels: twice the time saves a tenth of the bytes.
const BROTLI_LEVEL: u32 = 1;
const ZSTD_LEVEL: i32 = 1;
/// Logarithm of brotli's window: its usual one.
const BROTLI_WINDOW: u32 = 22;

/// A content coding (RFC 9110, section 8.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Identity,
    Zstd,
    Brotli,
    Gzip,
}

impl Encoding {
    /// The coding that an `Accept-Encoding` header prefers; of equal ones the fastest.
    pub(crate) fn preferred(headers: &HeaderMap) -> Self {
        let mut best = (0.0, Self::Identity);
        for coding in [Self::Zstd, Self::Brotli, Self::Gzip] {
            let quality = coding.name().map_or(0.0, |name| quality_of_coding(headers, name));
            if quality > best.0 {
                best = (quality, coding);
            }
        }
        best.1
    }

    /// Its name in `Content-Encoding`, where there is one.
    pub(crate) fn name(self) -> Option<&'static str> {
        match self {
            Self::Identity => None,
            Self::Zstd => Some("zstd"),
            Self::Brotli => Some("br"),
            Self::Gzip => Some("gzip"),
        }
    }

    /// Memory that writing an answer of at most `bytes` may take.
    pub(crate) fn most_bytes(self, bytes: usize) -> usize {
        match self {
            Self::Identity => bytes,
            // Both exist for a moment, and what can't be compressed grows by its frames.
            _ => bytes.saturating_mul(2).saturating_add(2 * BUFFER),
        }
    }

    /// Compresses an answer, and says how it is coded now. Blocks for as long as that takes.
    ///
    /// # Errors
    /// What an encoder fails with.
    pub(crate) fn encode(self, bytes: Vec<u8>) -> io::Result<(Vec<u8>, Self)> {
        if bytes.len() < SMALLEST {
            return Ok((bytes, Self::Identity));
        }
        let coded = match self {
            Self::Identity => return Ok((bytes, self)),
            Self::Zstd => zstd::bulk::compress(&bytes, ZSTD_LEVEL)?,
            Self::Brotli => {
                let coded = Vec::new();
                let (level, window) = (BROTLI_LEVEL, BROTLI_WINDOW);
                let mut encoder = brotli::CompressorWriter::new(coded, BUFFER, level, window);
                encoder.write_all(&bytes)?;
                encoder.flush()?;
                encoder.into_inner()
            }
            Self::Gzip => {
                let mut encoder = GzEncoder::new(Vec::new(), flate2::Compression::fast());
                encoder.write_all(&bytes)?;
                encoder.finish()?
            }
        };
        Ok((coded, self))
    }
}

/// Notes in the headers how an answer is coded.
pub(crate) fn note(headers: &mut HeaderMap, encoding: Encoding) {
    headers.append(header::VARY, HeaderValue::from_static("accept-encoding"));
    if let Some(coding) = encoding.name() {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(coding));
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    fn preferred(text: &'static str) -> Encoding {
        let mut headers = HeaderMap::new();
        headers.insert(header::ACCEPT_ENCODING, HeaderValue::from_static(text));
        Encoding::preferred(&headers)
    }

    #[test]
    fn the_fastest_of_the_preferred_codings_is_taken() {
        for (text, expected) in [
            ("gzip, deflate, br, zstd", Encoding::Zstd),
            ("gzip, deflate, br", Encoding::Brotli),
            ("gzip;q=1.0, br;q=0.5", Encoding::Gzip),
            ("zstd;q=0, *", Encoding::Brotli),
            ("GZIP", Encoding::Gzip),
            ("deflate", Encoding::Identity),
            ("identity", Encoding::Identity),
            ("", Encoding::Identity),
        ] {
            assert_eq!(preferred(text), expected, "{text}");
        }
        assert_eq!(Encoding::preferred(&HeaderMap::new()), Encoding::Identity);
    }

    #[test]
    fn every_coding_is_read_back() {
        let plain: Vec<u8> = (0..100_000_u32).flat_map(|n| (n / 7 % 251).to_le_bytes()).collect();
        for coding in [Encoding::Zstd, Encoding::Brotli, Encoding::Gzip] {
            let (coded, coding) = coding.encode(plain.clone()).unwrap();
            assert!(coded.len() < plain.len() / 4, "{coding:?} {}", coded.len());
            let mut back = Vec::new();
            match coding {
                Encoding::Zstd => back = zstd::decode_all(&coded[..]).unwrap(),
                Encoding::Brotli => {
                    brotli::Decompressor::new(&coded[..], BUFFER).read_to_end(&mut back).unwrap();
                }
                _ => {
                    flate2::read::GzDecoder::new(&coded[..]).read_to_end(&mut back).unwrap();
                }
            }
            assert!(back == plain, "{coding:?}");
            let short = coding.encode(vec![1; SMALLEST - 1]).unwrap();
            assert_eq!(short, (vec![1; SMALLEST - 1], Encoding::Identity));
        }
    }
}
