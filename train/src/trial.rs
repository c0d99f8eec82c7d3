//! A short dance that an imported model is tried with: what loads may still dance to nothing.

use std::{fmt, path::Path};

use bailando::engine::{Engine, EngineConfig, EngineError, GenerationOptions, GenerationRequest};

/// Share of a half's codes from which on one of them counts as repeated.
const REPEATED: f64 = 0.75;
/// Length of the music, seconds.
const SECONDS: usize = 8;
/// Samples a second.
const RATE: usize = 22_050;
/// Samples between the beats: 120 a minute.
const BEAT: usize = RATE / 2;
/// Temperature that is tried where the model's own repeats one code.
const WARMER: f32 = 1.0;

/// What the dance was.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// Pairs of codes in the dance.
    pub codes: usize,
    /// Different ones among them.
    pub different: usize,
    /// A half that repeats one code, and what helps.
    pub repeated: Option<Repeated>,
}

/// A half of the body that repeats one code.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeated {
    /// `upper` or `lower`.
    pub half: &'static str,
    /// The code.
    pub code: u32,
    /// How often it occurs.
    pub times: usize,
    /// Temperature of the dance.
    pub temperature: f32,
    /// Whether temperature 1 mends it.
    pub mended: bool,
}

/// Dances eight seconds of a plain beat with the model in `folder`, and once more at temperature 1
/// where a half repeats one code.
///
/// # Errors
/// [`EngineError`]: the model cannot dance.
pub fn try_dance(folder: &Path) -> Result<Trial, EngineError> {
    let engine = Engine::open(&EngineConfig::new(folder))?;
    let halves = dance(&engine, None)?;
    let [upper, lower] = &halves;
    let mut pairs: Vec<_> = upper.iter().zip(lower).collect();
    let codes = pairs.len();
    pairs.sort_unstable();
    pairs.dedup();
    let temperature = engine.manifest().sampling.temperature;
    let repeated = match repeated(&halves) {
        Some((half, code, times)) => {
            let warmer = temperature < WARMER;
            let mended = warmer && repeated(&dance(&engine, Some(WARMER))?).is_none();
            Some(Repeated { half, code, times, temperature, mended })
        }
        None => None,
    };
    Ok(Trial { codes, different: pairs.len(), repeated })
}

fn dance(engine: &Engine, temperature: Option<f32>) -> Result<[Vec<u32>; 2], EngineError> {
    let options = GenerationOptions { seed: Some(1), temperature, ..GenerationOptions::default() };
    let output = engine.generate(GenerationRequest::audio(beat(), options))?;
    Ok([output.codes.upper, output.codes.lower])
}

/// The half whose most frequent code makes up most of it, that code, and how often it occurs.
fn repeated(halves: &[Vec<u32>; 2]) -> Option<(&'static str, u32, usize)> {
    let most = |codes: &[u32]| {
        let times = |code| codes.iter().filter(|&&other| other == code).count();
        codes.iter().map(|&code| (times(code), code)).max()
    };
    let halves = ["upper", "lower"].into_iter().zip(halves);
    let found = halves.filter_map(|(half, codes)| {
        let (times, code) = most(codes)?;
        (times as f64 >= REPEATED * codes.len() as f64).then_some((half, code, times))
    });
    found.max_by_key(|&(.., times)| times)
}

/// A WAV of a low drum on every beat, and a high one between two.
fn beat() -> Vec<u8> {
    let sample = |n: usize| {
        let drum = |since: usize, hertz: f64, decay: f64| {
            let seconds = since as f64 / RATE as f64;
            (-decay * seconds).exp() * (std::f64::consts::TAU * hertz * seconds).sin()
        };
        let value =
            0.6 * drum(n % BEAT, 90.0, 12.0) + 0.3 * drum((n + BEAT / 2) % BEAT, 1_800.0, 60.0);
        ((value * 32_767.0) as i16).to_le_bytes()
    };
    let samples: Vec<u8> = (0..SECONDS * RATE).flat_map(sample).collect();
    let word = |value: usize| (value as u32).to_le_bytes();
    [
        &b"RIFF"[..],
        &word(36 + samples.len()),
        b"WAVEfmt \x10\0\0\0\x01\0\x01\0",
        &word(RATE),
        &word(2 * RATE),
        b"\x02\0\x10\0data",
        &word(samples.len()),
        &samples,
    ]
    .concat()
}

impl fmt::Display for Trial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(repeated) = &self.repeated else {
            return write!(
                f,
                "tried on {SECONDS} s of a plain beat: {} different pairs among {} codes",
                self.different, self.codes
            );
        };
        let Repeated { half, code, times, temperature, mended } = repeated;
        write!(
            f,
            "warning: on {SECONDS} s of a plain beat the {half} body repeats code {code} in \
             {times} of {} codes at temperature {temperature}: ",
            self.codes
        )?;
        if *mended {
            return write!(
                f,
                "with temperature {WARMER} it does not; import again with --temperature {WARMER} \
                 --force, or set sampling.temperature in manifest.json"
            );
        }
        if *temperature < WARMER {
            write!(f, "so it does at {WARMER}; ")?;
        }
        write!(f, "check --heads (the checkpoint does not hold it), --profile and --start-codes")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_half_that_stays_at_one_code_is_found() {
        let varied: Vec<u32> = (0..60).collect();
        let stuck: Vec<u32> = (0..60).map(|place| if place < 50 { 7 } else { place }).collect();
        assert_eq!(repeated(&[varied.clone(), varied.clone()]), None);
        assert_eq!(repeated(&[varied.clone(), stuck.clone()]), Some(("lower", 7, 50)));
        assert_eq!(repeated(&[stuck, vec![3; 60]]), Some(("lower", 3, 60)));
        assert_eq!(repeated(&[Vec::new(), Vec::new()]), None);
        let half: Vec<u32> = (0..60).map(|place| place % 2).collect();
        assert_eq!(repeated(&[half.clone(), half]), None);
    }

    #[test]
    fn what_helps_is_said() {
        let told = |temperature, mended| {
            let repeated = Repeated { half: "upper", code: 7, times: 58, temperature, mended };
            Trial { codes: 60, different: 3, repeated: Some(repeated) }.to_string()
        };
        assert!(told(0.0, true).contains("import again with --temperature 1 --force"));
        assert!(told(0.0, false).contains("so it does at 1; check --heads"));
        assert!(told(1.0, false).contains("temperature 1: check --heads"));
    }
}
