//! What the fuzz target and the test of its corpus do with bytes from a stranger, and what must
//! hold whatever the bytes are. It says whether it could use them. Not a part of the library.

use std::path::Path;

use bailando::model::WeightStorage;

use crate::{
    checkpoint::TorchCheckpoint,
    onnx::{InputRanges, decoder_graph, encoder_graph, gpt_graph, receptive_codes},
    weights::{CriticWeights, GptWeights, VqVaeWeights},
};

/// Bytes as a PyTorch checkpoint: container, pickle, tensors, networks, graphs.
#[must_use]
pub fn checkpoint(bytes: &[u8]) -> bool {
    let open = || TorchCheckpoint::from_bytes(Path::new("checkpoint"), bytes.to_vec());
    let Ok(mut checkpoint) = open() else {
        return false;
    };
    let names: Vec<String> = checkpoint.names().map(str::to_owned).collect();
    let tensors: Vec<_> = names.iter().map(|name| checkpoint.tensor(name)).collect();
    let values: usize = tensors.iter().flatten().map(|tensor| tensor.data().len()).sum();
    assert!(values <= bytes.len(), "{values} of {} bytes", bytes.len());
    let all = tensors.iter().all(Result::is_ok);
    if let Ok(weights) = VqVaeWeights::from_checkpoint(&mut checkpoint) {
        assert!(receptive_codes(&weights) > 0);
        let _ = decoder_graph(&weights, WeightStorage::F16);
        let _ = encoder_graph(&weights, WeightStorage::F32);
    }
    for heads in [1, 2] {
        if let Ok(weights) = GptWeights::from_checkpoint(&mut checkpoint, heads) {
            let _ = gpt_graph(&weights, WeightStorage::Int8, &InputRanges::default());
        }
        let _ = CriticWeights::from_checkpoint(&mut checkpoint, heads);
    }
    all
}
