use std::io::Write;

use proptest::prelude::*;

use super::*;

/// `{'model': OrderedDict(module.weight = [2, 2] float32), 'config': EasyDict(), 'epoch': 1}`.
fn object_pickle() -> Vec<u8> {
    let mut pickle = b"\x80\x02}(X\x05\x00\x00\x00modelccollections\nOrderedDict\n)R".to_vec();
    pickle.extend(b"X\x0d\x00\x00\x00module.weight");
    pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storage");
    pickle.extend(b"ctorch\nFloatStorage\nX\x01\x00\x00\x007X\x06\x00\x00\x00cuda:0K\x04tQ");
    pickle.extend(b"K\x00K\x02K\x02\x86K\x02K\x01\x86\x89ccollections\nOrderedDict\n)RtRs");
    pickle.extend(b"X\x06\x00\x00\x00configceasydict\nEasyDict\n)\x81(X\x01\x00\x00\x00aK\x01u");
    pickle.extend(b"X\x05\x00\x00\x00epochK\x01u.");
    pickle
}

fn values() -> Vec<u8> {
    [1.0_f32, 2.0, 3.0, 4.0].iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn legacy() -> Vec<u8> {
    let mut file = legacy::MAGIC.to_vec();
    file.extend(b"\x80\x02M\xe9\x03.\x80\x02}X\x0d\x00\x00\x00little_endian\x88s.");
    file.extend(object_pickle());
    file.extend(b"\x80\x02]X\x01\x00\x00\x007a.");
    file.extend(4_i64.to_le_bytes());
    file.extend(values());
    file
}

fn zip_with(method: zip::CompressionMethod, entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(method);
    for (name, content) in entries {
        writer.start_file(*name, options).unwrap();
        writer.write_all(content).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn zipped() -> Vec<u8> {
    let entries: [(&str, &[u8]); 3] =
        [("a/data.pkl", &object_pickle()), ("a/byteorder", b"little"), ("a/data/7", &values())];
    zip_with(zip::CompressionMethod::Stored, &entries)
}

fn open(bytes: Vec<u8>) -> Result<TorchCheckpoint, CheckpointError> {
    TorchCheckpoint::from_bytes(Path::new("x.pt"), bytes)
}

/// Opens and reads everything; the first error's line.
fn read_all(bytes: Vec<u8>) -> Result<(), String> {
    let mut checkpoint = open(bytes).map_err(|error| error.to_string())?;
    let names: Vec<String> = checkpoint.names().map(str::to_owned).collect();
    for name in names {
        checkpoint.tensor(&name).map_err(|error| error.to_string())?;
    }
    Ok(())
}

#[test]
fn both_containers_hold_the_same_tensor() {
    for bytes in [legacy(), zipped()] {
        let mut checkpoint = open(bytes).unwrap();
        assert_eq!(checkpoint.names().collect::<Vec<_>>(), ["weight"]);
        let tensor = checkpoint.tensor("weight").unwrap();
        assert_eq!(tensor.shape(), [2, 2]);
        assert_eq!(tensor.data(), [1.0, 2.0, 3.0, 4.0]);
    }
}

#[test]
fn a_missing_tensor_is_named() {
    let error = open(legacy()).unwrap().tensor("bias").unwrap_err();
    assert_eq!(error.to_string(), "x.pt: tensor `bias` is missing");
}

#[test]
fn every_truncation_is_an_error() {
    for whole in [legacy(), zipped()] {
        for length in 0..whole.len() {
            let cut = whole[..length].to_vec();
            assert!(read_all(cut).is_err(), "{length} of {} bytes", whole.len());
        }
    }
}

#[test]
fn other_files_are_no_checkpoints() {
    for bytes in [&b""[..], b"hello", b"\x89PNG\r\n", b"PK\x03\x04"] {
        assert!(open(bytes.to_vec()).is_err());
    }
    let no_pickle = zip_with(zip::CompressionMethod::Stored, &[("readme", b"hi")]);
    let error = open(no_pickle).unwrap_err().to_string();
    assert_eq!(error, "x.pt: zip entry `*/data.pkl` is missing");
}

#[test]
fn big_endian_values_are_refused() {
    let pickle = object_pickle();
    let entries: [(&str, &[u8]); 2] = [("a/data.pkl", &pickle), ("a/byteorder", b"big")];
    let error = open(zip_with(zip::CompressionMethod::Stored, &entries)).unwrap_err();
    assert_eq!(error.to_string(), "x.pt: the values are not little-endian");
}

#[test]
fn a_storage_shorter_than_declared_is_refused() {
    let entries: [(&str, &[u8]); 2] = [("a/data.pkl", &object_pickle()), ("a/data/7", &[0; 12])];
    let error = read_all(zip_with(zip::CompressionMethod::Stored, &entries)).unwrap_err();
    assert_eq!(error, "x.pt: tensor `weight`: storage `7` should have 16 bytes, but 12 are there");
    let mut short = legacy();
    short.pop();
    let error = read_all(short).unwrap_err();
    assert_eq!(error, "x.pt: storage `7` should have 16 bytes, but 15 are there");
}

#[test]
fn a_legacy_storage_that_claims_exabytes_allocates_nothing() {
    let mut file = legacy();
    let header = file.len() - 24;
    file[header..header + 8].copy_from_slice(&(i64::MAX / 8).to_le_bytes());
    assert!(read_all(file).unwrap_err().contains("should have"));
}

#[test]
fn damage_to_zipped_values_is_noticed() {
    let mut file = zipped();
    let values = values();
    let at = file.windows(values.len()).position(|window| window == values).unwrap();
    file[at] ^= 1;
    assert!(read_all(file).is_err());
}

fn fixture(name: &str) -> Vec<u8> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/model");
    std::fs::read(root.join(name)).unwrap()
}

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(config(2_000))]

    #[test]
    fn mutated_small_files_never_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        zip in any::<bool>(),
    ) {
        let mut bytes = if zip { zipped() } else { legacy() };
        for (index, byte) in edits {
            let at = index.index(bytes.len());
            bytes[at] = byte;
        }
        let _ = read_all(bytes);
    }

    #[test]
    fn random_pickles_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = pickle::interpret(&bytes);
    }
}

proptest! {
    #![proptest_config(config(60))]

    #[test]
    fn mutated_official_files_never_panic(
        edits in prop::collection::vec((0..40_000_usize, any::<u8>()), 1..20),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = fixture("tiny_gpt.pt");
        for (at, byte) in edits {
            bytes[at] = byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let _ = read_all(bytes);
    }
}
