//! Checkpoints as people have them: safetensors, half precision, wrapped names; and what only looks
//! like one.

use std::{
    collections::BTreeMap,
    fs,
    io::Write,
    path::{Path, PathBuf},
};

use bailando::model::Manifest;
use bailando_train::{
    HostTensor,
    checkpoint::TorchCheckpoint,
    import::import,
    trial::try_dance,
    weights::{GptWeights, VqVaeWeights},
};
use half::{bf16, f16};
use safetensors::{Dtype, tensor::TensorView};

use crate::common::{HEADS, fixture, options, stdout, train};

/// The tensors of a golden checkpoint that networks use.
fn tensors(name: &str) -> BTreeMap<String, HostTensor> {
    let mut checkpoint = TorchCheckpoint::open(&fixture(name)).unwrap();
    let names: Vec<String> = checkpoint.names().map(str::to_owned).collect();
    let read = names.into_iter().filter_map(|name| {
        let tensor = checkpoint.tensor(&name).ok()?;
        Some((name, tensor))
    });
    read.collect()
}

/// Writes them as safetensors, with `prefix` in front of every name.
fn write(path: &Path, tensors: &BTreeMap<String, HostTensor>, dtype: Dtype, prefix: &str) {
    let bytes = |value: &f32| match dtype {
        Dtype::F16 => f16::from_f32(*value).to_le_bytes().to_vec(),
        Dtype::BF16 => bf16::from_f32(*value).to_le_bytes().to_vec(),
        _ => value.to_le_bytes().to_vec(),
    };
    let values: Vec<_> = tensors
        .iter()
        .map(|(name, tensor)| {
            let bytes: Vec<u8> = tensor.data().iter().flat_map(bytes).collect();
            (format!("{prefix}{name}"), tensor.shape().to_vec(), bytes)
        })
        .collect();
    let views = values
        .iter()
        .map(|(name, shape, bytes)| (name, TensorView::new(dtype, shape.clone(), bytes).unwrap()));
    fs::write(path, safetensors::serialize(views, None).unwrap()).unwrap();
}

/// Both golden checkpoints in that form.
fn written(folder: &Path, dtype: Dtype, prefix: &str) -> [PathBuf; 2] {
    ["tiny_vqvae", "tiny_gpt"].map(|name| {
        let path = folder.join(format!("{name}.safetensors"));
        write(&path, &tensors(&format!("{name}.pt")), dtype, prefix);
        path
    })
}

fn imported(vqvae: &Path, gpt: &Path, out: &Path) -> Manifest {
    import(&options(vqvae, gpt, out)).unwrap()
}

#[test]
fn safetensors_of_the_same_tensors_are_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name);
    let (vqvae, gpt) = (fixture("tiny_vqvae.pt"), fixture("tiny_gpt.pt"));
    let pickled = imported(&vqvae, &gpt, &out("pickled"));
    for prefix in ["", "_orig_mod.", "module._orig_mod."] {
        let [vqvae, gpt] = written(folder.path(), Dtype::F32, prefix);
        let read = imported(&vqvae, &gpt, &out(&format!("read{prefix}")));
        assert_eq!(read.files, pickled.files, "{prefix}");
    }
}

#[test]
fn half_precision_is_widened() {
    let folder = tempfile::tempdir().unwrap();
    for (dtype, bits) in [(Dtype::F16, 11), (Dtype::BF16, 8)] {
        let [vqvae, gpt] = written(folder.path(), dtype, "");
        let mut read = TorchCheckpoint::open(&gpt).unwrap();
        let found = GptWeights::from_checkpoint(&mut read, HEADS).unwrap();
        VqVaeWeights::from_checkpoint(&mut TorchCheckpoint::open(&vqvae).unwrap()).unwrap();
        let expected = crate::common::gpt();
        let pairs = found.upper_head.data().iter().zip(expected.upper_head.data());
        for (found, expected) in pairs {
            let rounded = expected.abs() * 0.5_f32.powi(bits) + 1e-7;
            assert!((found - expected).abs() <= rounded, "{found} {expected}");
        }
        assert_ne!(found, expected);
    }
}

/// A zip as `torch.jit.save` writes it.
fn torch_script() -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let stored =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let program: [(&str, &[u8]); 3] = [
        ("m/data.pkl", b"\x80\x02c__torch__\nGpt\n)\x81."),
        ("m/code/__torch__.py", b"class Gpt(Module): .."),
        ("m/constants.pkl", b"\x80\x02)."),
    ];
    for (name, content) in program {
        writer.start_file(name, stored).unwrap();
        writer.write_all(content).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn what_only_looks_like_a_checkpoint_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let (vqvae, gpt) = (fixture("tiny_vqvae.pt"), fixture("tiny_gpt.pt"));
    let script = file("script.pt", &torch_script());
    let index = br#"{"metadata": {}, "weight_map": {"a": "model-00001-of-00002.safetensors",
        "b": "model-00002-of-00002.safetensors"}}"#;
    let index = file("model.safetensors.index.json", index);
    let mut part = tensors("tiny_gpt.pt");
    part.remove("gpt_base.pos_emb");
    let shard = folder.path().join("model-00001-of-00002.safetensors");
    write(&shard, &part, Dtype::F32, "");
    let whole = fs::read(&shard).unwrap();
    let cut = file("cut.safetensors", &whole[..whole.len() - 100]);
    let out = folder.path().join("model");
    for (vqvae, gpt, words) in [
        (&vqvae, &script, ["TorchScript", "torch.save(model.state_dict()"]),
        (&vqvae, &index, ["index of a checkpoint in several files", "model-00002-of-00002"]),
        (&vqvae, &shard, ["`gpt_base.pos_emb` is missing", "part of a checkpoint"]),
        (&vqvae, &cut, ["cut.safetensors", "damaged or cut off"]),
        (&gpt, &vqvae, ["motion GPT, not a pose VQ-VAE", "the two files are swapped"]),
        (&gpt, &gpt, ["tiny_gpt.pt: this is a motion GPT", "give it with --gpt"]),
        (&vqvae, &vqvae, ["tiny_vqvae.pt: this is a pose VQ-VAE", "give it with --vqvae"]),
    ] {
        let error = import(&options(vqvae, gpt, &out)).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
        assert!(!error.contains('\n') && !out.exists());
    }
}

/// The golden GPT whose heads like one code a little more than all others, which are alike.
fn stuck(folder: &Path) -> PathBuf {
    let mut tensors = tensors("tiny_gpt.pt");
    let channels = tensors["gpt_head.ln_f.bias"].dim(0);
    let rows = tensors["gpt_head.head_up.weight"].dim(0);
    let tensor = |shape: Vec<usize>, value: &dyn Fn(usize) -> f32| {
        let count = shape.iter().product();
        HostTensor::new(shape, (0..count).map(value).collect()).unwrap()
    };
    let one = |place: usize| if place == 0 { 1.0 } else { 0.0 };
    tensors.insert("gpt_head.ln_f.weight".into(), tensor(vec![channels], &|_| 0.0));
    tensors.insert("gpt_head.ln_f.bias".into(), tensor(vec![channels], &one));
    let liked = |place: usize| if place == 5 * channels { 0.5 } else { 0.0 };
    for half in ["up", "down"] {
        let head = tensor(vec![rows, channels], &liked);
        tensors.insert(format!("gpt_head.head_{half}.weight"), head);
    }
    let path = folder.join("stuck.safetensors");
    write(&path, &tensors, Dtype::F32, "");
    path
}

#[test]
fn a_model_that_repeats_a_code_is_reported_with_what_mends_it() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("model");
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let (vqvae, gpt) = (text(&fixture("tiny_vqvae.pt")), text(&stuck(folder.path())));
    let mut arguments = vec!["import", "--vqvae", &vqvae, "--gpt", &gpt, "--heads", "4", "--out"];
    let out_text = text(&out);
    arguments.push(&out_text);
    let output = train(&arguments);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let report = stdout(&output);
    let warned = report.lines().find(|line| line.starts_with("warning: ")).unwrap();
    assert!(warned.contains(" body repeats code 5 in "), "{warned}");
    assert!(warned.contains("import again with --temperature 1 --force"), "{warned}");
    // What it says helps, helps.
    arguments.extend(["--temperature", "1", "--force"]);
    let report = stdout(&train(&arguments));
    assert!(report.contains("tried on 8 s of a plain beat"), "{report}");
    assert!(try_dance(&out).unwrap().repeated.is_none());
}
