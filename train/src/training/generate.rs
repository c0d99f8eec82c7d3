//! Motion of a finished run for the songs of the test split, to measure runs that have no export.

use std::{fs, io::Write, path::Path, sync::Arc};

use bailando::motion::Positions;
use ndarray::Array2;
use ndarray_npy::WriteNpyExt;

use super::{
    config::Config,
    decode::MotionDecoder,
    device::on_device,
    error::TrainError,
    files::replace_file,
    policy::Policy,
    sampling::{Sampler, SamplingRequest},
    songs::song_rows,
    windows::generator,
};
use crate::{
    data::{Dataset, Evaluation, MusicSource, Portion},
    nn::{Kernels, Parameters, Trainable},
};

/// Pieces that are generated side by side.
const PIECES_AT_ONCE: usize = 64;
/// A generator's seed for this purpose.
const PIECES: u64 = 0x7465_7374;

/// A piece of the test split that has music.
pub(super) struct TestPiece {
    id: String,
    /// `[rows, columns]`, not scaled.
    rows: Array2<f32>,
    style: Option<String>,
}

#[cfg(test)]
impl TestPiece {
    pub(super) fn new(id: &str, rows: Array2<f32>) -> Self {
        let id = id.to_owned();
        Self { id, rows, style: None }
    }
}

/// Writes a motion for every piece of the test split that has music, `folder/<id>.npy`,
/// `[frames, 24, 3]` at 60 a second, and returns how many. The root starts at the origin. Policy
/// and temperature are those of an export.
///
/// # Errors
/// [`TrainError::StageMissing`] where the run is not finished; what cannot be read or written.
pub fn generate_test_motions(
    config: &Config,
    seed: u64,
    folder: &Path,
    output: &mut impl Write,
) -> Result<usize, TrainError> {
    let policy = Policy::latest(config)?;
    let pieces = test_pieces(config, output)?;
    fs::create_dir_all(folder).map_err(TrainError::file(folder))?;
    for some in pieces.chunks(PIECES_AT_ONCE) {
        let motions = on_device!(config.run.device.as_str(), |A, device| {
            motions::<A>(config, &policy, some, seed, &device)
        })?;
        for (piece, motion) in some.iter().zip(motions) {
            write(folder, &piece.id, motion)?;
        }
    }
    Ok(pieces.len())
}

fn test_pieces(config: &Config, output: &mut impl Write) -> Result<Vec<TestPiece>, TrainError> {
    let data = &config.data;
    let folders = data.all_folders();
    let test: Portion<Evaluation> =
        Dataset::open_all(&folders, &data.open_options())?.evaluation()?;
    let songs = test.recordings().iter().flat_map(|dance| {
        let songs = dance.songs().iter();
        songs.map(|song| (song, &dance.marks().style))
    });
    let songs = songs.filter_map(|(song, style)| Some((&song.id, song.music.as_ref()?, style)));
    let songs: Vec<(&String, &MusicSource, &Option<String>)> = songs.collect();
    let wanted = songs.iter().map(|&(_, music, _)| (music.clone(), 1));
    let known = song_rows(data, wanted.collect(), &Arc::default(), output)?;
    let mut pieces = Vec::with_capacity(songs.len());
    for (id, music, style) in songs {
        let failed = |message: &str| TrainError::Data {
            path: folders[0].path.clone(),
            message: format!("piece `{id}` {message}"),
        };
        if Path::new(id).file_name() != Some(id.as_ref()) {
            return Err(failed("cannot be the name of a file"));
        }
        let rows = known.get(music).map(|rows| rows.phase(0));
        let rows = rows.filter(|rows| rows.nrows() > 1);
        pieces.push(TestPiece {
            id: id.clone(),
            rows: rows.ok_or_else(|| failed("has too little music"))?.clone(),
            style: style.clone(),
        });
    }
    Ok(pieces)
}

/// Generates and decodes; `None` where a decoder gives NaN. A piece is the same beside any others.
pub(super) fn motions<A: Trainable>(
    config: &Config,
    policy: &Policy,
    pieces: &[TestPiece],
    seed: u64,
    device: &A::Device,
) -> Result<Vec<Option<Positions>>, TrainError> {
    let decoder = MotionDecoder::<A::InnerBackend>::read(config, device)?;
    if !config.ablation.continuous {
        let codes = codes::<A::InnerBackend>(config, policy, pieces, seed, device).into_iter();
        return Ok(codes.map(|codes| decoder.positions(&codes)).collect());
    }
    let parameters = Parameters::<A::InnerBackend>::from_store(&policy.store, device);
    let music = scaled(policy, pieces);
    let requests = requests(policy, pieces, &music, seed);
    let starts = requests.iter().map(|request| decoder.pair(request.start));
    let sampler = sampler(config, policy, &parameters);
    let found = sampler.regress(&requests, starts.collect()).into_iter();
    Ok(found.map(|vectors| decoder.positions_of_vectors(vectors)).collect())
}

/// Generates the upper and lower codes of each piece.
pub(super) fn codes<B: Kernels>(
    config: &Config,
    policy: &Policy,
    pieces: &[TestPiece],
    seed: u64,
    device: &B::Device,
) -> Vec<[Vec<i32>; 2]> {
    let parameters = Parameters::<B>::from_store(&policy.store, device);
    let music = scaled(policy, pieces);
    let requests = requests(policy, pieces, &music, seed);
    sampler(config, policy, &parameters).generate(requests)
}

fn sampler<'a, B: Kernels>(
    config: &Config,
    policy: &'a Policy,
    parameters: &'a Parameters<B>,
) -> Sampler<'a, B> {
    Sampler { net: &policy.net, parameters, temperature: f64::from(config.export.temperature) }
}

fn scaled(policy: &Policy, pieces: &[TestPiece]) -> Vec<Array2<f32>> {
    let pieces = pieces.iter();
    pieces.map(|piece| policy.conditioned(&piece.rows, piece.style.as_deref())).collect()
}

fn requests<'a>(
    policy: &Policy,
    pieces: &[TestPiece],
    music: &'a [Array2<f32>],
    seed: u64,
) -> Vec<SamplingRequest<'a>> {
    let requests = pieces.iter().zip(music).map(|(piece, music)| {
        let random = generator(seed ^ PIECES, name_number(&piece.id));
        SamplingRequest::new(music.view(), &policy.starts, random)
    });
    requests.collect()
}

/// Hashes a name (FNV-1a): a piece does not depend on the other pieces of a data folder.
fn name_number(id: &str) -> u64 {
    id.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

fn write(folder: &Path, id: &str, motion: Option<Positions>) -> Result<(), TrainError> {
    let path = folder.join(format!("{id}.npy"));
    let failed = |message: String| TrainError::state(&path)(message);
    let motion =
        motion.ok_or_else(|| failed("the motion has values that are not numbers".into()))?;
    let mut bytes = Vec::new();
    let written = motion.write_npy(&mut bytes);
    written.map_err(|error| failed(error.to_string()))?;
    replace_file(&path, &bytes).map_err(TrainError::file(&path))
}
