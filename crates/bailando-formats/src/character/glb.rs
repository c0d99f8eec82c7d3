//! GLB and VRM files of callers: read for their nodes, and given back with one more animation.

use glam::{DMat4, DQuat, DVec3};
use serde::Deserialize;
use serde_json::{json, value::RawValue};

use super::{
    container::{ALIGNMENT, Chunks, chunks},
    limits::{RigLimits, check_name},
    parts::Parts,
    pose::Poses,
    refusal::problem,
    splice::{self, Splice},
    tree::{Bone, Tree},
    vrm,
};
use crate::{
    error::FormatError,
    glb::{TAKE, tolerance_at},
    keys::{Keys, reduce_rotations},
};

/// Code of 32-bit floats in glTF.
const FLOAT: u32 = 5126;
/// Most buffers that are looked at.
const BUFFERS: usize = 1000;
/// Most animations that are looked at.
const ANIMATIONS: usize = 1000;

/// A GLB or VRM file that gets one more animation, in the place of an earlier dance if it has one.
#[derive(Clone, Debug)]
pub(super) struct GlbFile {
    bytes: Vec<u8>,
    chunks: Chunks,
    pub(super) is_vrm: bool,
}

/// The document, as far as it is looked at; values keep their text.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Document<'a> {
    // It must be there; what is added comes after it.
    #[serde(borrow)]
    #[expect(dead_code, reason = "a document without it is refused")]
    asset: &'a RawValue,
    #[serde(borrow)]
    nodes: Option<&'a RawValue>,
    #[serde(borrow)]
    skins: Option<&'a RawValue>,
    #[serde(borrow)]
    animations: Option<&'a RawValue>,
    #[serde(borrow)]
    accessors: Option<&'a RawValue>,
    #[serde(borrow)]
    buffer_views: Option<&'a RawValue>,
    #[serde(borrow)]
    buffers: Option<&'a RawValue>,
    #[serde(borrow)]
    extensions: Option<vrm::Extensions<'a>>,
}

#[derive(Deserialize)]
struct Node<'a> {
    #[serde(default)]
    name: String,
    #[serde(borrow)]
    children: Option<&'a RawValue>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
    #[serde(borrow)]
    matrix: Option<&'a RawValue>,
}

#[derive(Deserialize)]
struct Skin<'a> {
    #[serde(borrow)]
    joints: &'a RawValue,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Buffer<'a> {
    #[serde(borrow)]
    byte_length: &'a RawValue,
    #[serde(borrow)]
    uri: Option<&'a RawValue>,
}

fn unreadable<T>(what: &str, error: &serde_json::Error) -> Result<T, FormatError> {
    let error: String = error.to_string().chars().take(120).collect();
    problem(format!("{what} cannot be read: {error}"))
}

fn text<'a>(bytes: &'a [u8], chunks: &Chunks) -> Result<&'a str, FormatError> {
    let json = bytes.get(chunks.json.clone()).unwrap_or_default();
    std::str::from_utf8(json).or_else(|_| problem("its JSON is not UTF-8"))
}

fn document(text: &str) -> Result<Document<'_>, FormatError> {
    serde_json::from_str(text).or_else(|error| unreadable("its JSON", &error))
}

/// Reads a file; also the humanoid bones that VRM's extension names.
pub(super) fn read(
    bytes: Vec<u8>,
    limits: &RigLimits,
) -> Result<(GlbFile, Tree, Option<Parts>), FormatError> {
    let chunks = chunks(&bytes)?;
    let root = document(text(&bytes, &chunks)?)?;
    let tree = tree(&root, limits)?;
    binary_end(&root, &chunks)?;
    let extensions = root.extensions.unwrap_or_default();
    let (is_vrm, humanoid) = (extensions.is_vrm(), extensions.humanoid(&tree)?);
    Ok((GlbFile { bytes, chunks, is_vrm }, tree, humanoid))
}

fn nodes<'a>(root: &Document<'a>, limits: &RigLimits) -> Result<Vec<Node<'a>>, FormatError> {
    let count = splice::count("nodes", root.nodes)?;
    limits.check_bones(count)?;
    splice::array("nodes", root.nodes, limits.bones)
}

fn tree(root: &Document<'_>, limits: &RigLimits) -> Result<Tree, FormatError> {
    let nodes = nodes(root, limits)?;
    let mut parents = vec![None; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        for child in splice::array::<usize>("children", node.children, nodes.len())? {
            match parents.get_mut(child) {
                Some(parent @ None) => *parent = Some(index),
                Some(Some(_)) => return problem(format!("node {child} hangs on two nodes")),
                None => return problem(format!("node {index} has a child {child} that is none")),
            }
        }
    }
    let turns = skinned(root, &parents, limits)?;
    let mut bones = Vec::with_capacity(nodes.len());
    for (index, node) in nodes.iter().enumerate() {
        let (place, turn, scale) = rest(index, node)?;
        check_name(&node.name)?;
        bones.push(Bone {
            name: node.name.clone(),
            parent: parents[index],
            place,
            turn,
            scale,
            turns: turns.get(index).copied().unwrap_or(true),
        });
    }
    Tree::new(bones)
}

/// Returns whether each node is a joint of a skin; nothing where there are no skins.
fn skinned(
    root: &Document<'_>,
    parents: &[Option<usize>],
    limits: &RigLimits,
) -> Result<Vec<bool>, FormatError> {
    let skins: Vec<Skin<'_>> = splice::array("skins", root.skins, limits.bones)?;
    if skins.is_empty() {
        return Ok(Vec::new());
    }
    let mut joints = vec![false; parents.len()];
    for skin in skins {
        for joint in splice::array::<usize>("joints", Some(skin.joints), limits.bones)? {
            match joints.get_mut(joint) {
                Some(is_joint) => *is_joint = true,
                None => return problem(format!("a skin has the joint {joint}, which is no node")),
            }
        }
    }
    Ok(joints)
}

fn rest(index: usize, node: &Node<'_>) -> Result<(DVec3, DQuat, DVec3), FormatError> {
    let (scale, turn, place) = match node.matrix {
        Some(_)
            if node.translation.is_some() || node.rotation.is_some() || node.scale.is_some() =>
        {
            return problem(format!("node {index} has a matrix and other transforms beside it"));
        }
        Some(matrix) => {
            let numbers: Vec<f64> = splice::array("matrix", Some(matrix), 16)?;
            match <[f64; 16]>::try_from(numbers) {
                Ok(numbers) => DMat4::from_cols_array(&numbers).to_scale_rotation_translation(),
                Err(_) => return problem(format!("the matrix of node {index} has no 16 numbers")),
            }
        }
        None => (
            node.scale.map_or(DVec3::ONE, DVec3::from),
            node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array),
            node.translation.map_or(DVec3::ZERO, DVec3::from),
        ),
    };
    let length = turn.length();
    match place.is_finite() && scale.is_finite() && length.is_finite() && length > 0.5 {
        true => Ok((place, turn.normalize(), scale)),
        false => problem(format!("the transforms of node {index} are no numbers, or no rotation")),
    }
}

/// Returns the end of the binary chunk's data, at which more can be added.
fn binary_end(root: &Document<'_>, chunks: &Chunks) -> Result<usize, FormatError> {
    let buffers: Vec<Buffer<'_>> = splice::array("buffers", root.buffers, BUFFERS)?;
    match (buffers.first(), &chunks.binary) {
        (None, None) => Ok(0),
        (None, Some(_)) => problem("it has a BIN chunk and no buffer"),
        (Some(Buffer { uri: None, byte_length }), Some(binary)) => {
            match byte_length.get().parse::<usize>() {
                Ok(length) if length <= binary.len() => Ok(binary.len()),
                _ => problem(format!(
                    "its first buffer says that it has {} bytes, and its BIN chunk has {}",
                    byte_length.get().chars().take(24).collect::<String>(),
                    binary.len()
                )),
            }
        }
        _ => problem("its first buffer is not in the file: save it as one .glb file"),
    }
}

/// What is added to a document.
#[derive(Default)]
struct Added {
    bytes: Vec<u8>,
    accessors: Vec<String>,
    samplers: Vec<serde_json::Value>,
    channels: Vec<serde_json::Value>,
}

impl Added {
    /// Adds numbers; returns the index of their accessor among the added ones.
    fn accessor(
        &mut self,
        view: usize,
        kind: &str,
        numbers: &[f32],
        bounds: Option<[f32; 2]>,
    ) -> usize {
        let width = match kind {
            "VEC4" => 4,
            "VEC3" => 3,
            _ => 1,
        };
        let mut accessor = json!({
            "bufferView": view,
            "byteOffset": self.bytes.len(),
            "componentType": FLOAT,
            "count": numbers.len() / width,
            "type": kind,
        });
        if let Some([least, most]) = bounds {
            accessor["min"] = json!([least]);
            accessor["max"] = json!([most]);
        }
        self.bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        self.accessors.push(accessor.to_string());
        self.accessors.len() - 1
    }
}

impl GlbFile {
    /// About the most bytes of the file with a dance of so many frames: the file, and while it is
    /// put together what is added.
    pub(super) fn most_bytes(&self, parts: &Parts, frames: usize) -> usize {
        let bones: usize = parts.values().map(Vec::len).sum();
        let frame = 20 * bones + 16;
        let added = frame.saturating_mul(frames).saturating_add(1000 * bones);
        // The JSON's text exists beside the file.
        self.bytes.len().saturating_add(self.chunks.json.len()).saturating_add(2 * added)
    }

    /// Writes the file with one more animation.
    pub(super) fn write(&self, tree: &Tree, poses: &Poses) -> Result<Vec<u8>, FormatError> {
        if poses.hips.is_empty() {
            return Ok(self.bytes.clone());
        }
        let text = text(&self.bytes, &self.chunks)?;
        let root = document(text)?;
        let end = binary_end(&root, &self.chunks)?.next_multiple_of(ALIGNMENT);
        let view = splice::count("bufferViews", root.buffer_views)?;
        let first = splice::count("accessors", root.accessors)?;
        let added = animation(tree, poses, view, first);

        let mut splice = Splice::new(text);
        untangle(&root, tree, poses, &mut splice)?;
        let length = end + added.bytes.len();
        let buffers: Vec<Buffer<'_>> = splice::array("buffers", root.buffers, BUFFERS)?;
        match buffers.first() {
            Some(buffer) => splice.replace(buffer.byte_length, length.to_string()),
            None => {
                let buffer = json!({ "byteLength": length }).to_string();
                splice.append("buffers", root.buffers, &[buffer])?;
            }
        }
        let bytes = added.bytes.len();
        let new = json!({ "buffer": 0, "byteOffset": end, "byteLength": bytes }).to_string();
        splice.append("bufferViews", root.buffer_views, &[new])?;
        splice.append("accessors", root.accessors, &added.accessors)?;
        let Added { samplers, channels, .. } = &added;
        let new = json!({ "name": TAKE, "samplers": samplers, "channels": channels }).to_string();
        match earlier_take(&root)? {
            Some(earlier) => splice.replace(earlier, new),
            None => splice.append("animations", root.animations, &[new])?,
        }
        self.chunks.with(&self.bytes, &splice.finish(), &added.bytes)
    }
}

/// The animation of an earlier dance: programs that look for one by its name would find either.
fn earlier_take<'a>(root: &Document<'a>) -> Result<Option<&'a RawValue>, FormatError> {
    #[derive(Deserialize)]
    struct Named {
        name: String,
    }
    if splice::count("animations", root.animations)? > ANIMATIONS {
        return Ok(None);
    }
    let all: Vec<&RawValue> = splice::array("animations", root.animations, ANIMATIONS)?;
    let is_take = |animation: &&RawValue| {
        serde_json::from_str::<Named>(animation.get()).is_ok_and(|named| named.name == TAKE)
    };
    Ok(all.into_iter().find(is_take))
}

/// A node that is animated must not have a matrix (glTF 2.0, section 3.11): its parts instead.
fn untangle(
    root: &Document<'_>,
    tree: &Tree,
    poses: &Poses,
    splice: &mut Splice<'_>,
) -> Result<(), FormatError> {
    let nodes: Vec<Node<'_>> = splice::array("nodes", root.nodes, tree.bones.len())?;
    for &bone in &poses.bones {
        if let Some(matrix) = nodes.get(bone).and_then(|node| node.matrix) {
            let Bone { place, turn, scale, .. } = &tree.bones[bone];
            let parts = json!({
                "translation": place.to_array(),
                "rotation": turn.to_array(),
                "scale": scale.to_array(),
            })
            .to_string();
            let members = parts.trim_matches(['{', '}']).to_owned();
            splice.replace_member("matrix", matrix, members)?;
        }
    }
    Ok(())
}

/// Makes an animation whose accessors come after `first` others, in the buffer view `view`.
fn animation(tree: &Tree, poses: &Poses, view: usize, first: usize) -> Added {
    let mut added = Added::default();
    let seconds = |frame: usize| (frame as f64 / f64::from(poses.fps)) as f32;
    // Tracks with a key at every frame share their times.
    let mut every = None;
    let mut channel = |bone: usize, path: &str, frames: &[usize], kind: &str, values: &[f32]| {
        let mut input = || {
            let times: Vec<f32> = frames.iter().map(|&frame| seconds(frame)).collect();
            let bounds = times.first().copied().zip(times.last().copied());
            let bounds = bounds.map(|(least, most)| [least, most]);
            first + added.accessor(view, "SCALAR", &times, bounds)
        };
        let input = match frames.len() == poses.hips.len() {
            true => *every.get_or_insert_with(input),
            false => input(),
        };
        let output = first + added.accessor(view, kind, values, None);
        let sampler = added.samplers.len();
        added.samplers.push(json!({ "input": input, "output": output }));
        added.channels.push(json!({
            "sampler": sampler,
            "target": { "node": bone, "path": path },
        }));
    };
    // Feet stand still only where hips and legs have a key at every frame: a millimetre that a line
    // between keys is off comes and goes in a frame or two, which is centimetres a second.
    let size = tree.reach(poses.hips_bone).max(1e-9);
    let Keys { frames, values } = Keys::every(&poses.local_hips(tree));
    let values: Vec<f32> = values.iter().flat_map(|place| place.as_vec3().to_array()).collect();
    channel(poses.hips_bone, "translation", &frames, "VEC3", &values);
    for (index, (&bone, track)) in poses.bones.iter().zip(&poses.turns).enumerate() {
        let tolerance = tolerance_at(tree.reach(bone) / size);
        let Keys { frames, values } = match poses.carries_feet[index] {
            true => Keys::every(track),
            false => reduce_rotations(track, tolerance),
        };
        let values: Vec<f32> = values.iter().flat_map(|turn| turn.as_quat().to_array()).collect();
        channel(bone, "rotation", &frames, "VEC4", &values);
    }
    added
}
