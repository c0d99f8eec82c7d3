//! A glTF 2.0 document with one buffer, and its binary container (GLB).

use glam::{DQuat, Mat4, Vec3};
use gltf_json::{
    Accessor, Asset, Buffer, Index, Node, Root, Scene,
    accessor::{ComponentType, GenericComponentType, Type},
    animation::{Animation, Channel, Property, Sampler, Target},
    buffer::{self, View},
    scene::UnitQuaternion,
    validation::Checked::Valid,
};
use serde_json::{Value, json};

use crate::{error::FormatError, rig::Rig};

/// Bytes to which parts of the file are aligned.
const ALIGNMENT: usize = 4;
const HEADER: usize = 12;
const CHUNK_HEADER: usize = 8;
/// Largest number of a signed normalised 16-bit integer.
const SHORT_ONE: f64 = 32_767.0;

/// A document in the making.
pub(crate) struct Document {
    pub(crate) root: Root,
    bytes: Vec<u8>,
}

/// The elements of an accessor.
#[derive(Clone, Copy)]
pub(crate) struct Layout {
    pub(crate) component: ComponentType,
    pub(crate) kind: Type,
    pub(crate) normalized: bool,
    pub(crate) target: Option<buffer::Target>,
}

impl Layout {
    pub(crate) const fn floats(kind: Type) -> Self {
        Self { component: ComponentType::F32, kind, normalized: false, target: None }
    }
}

impl Document {
    /// Starts a document with about so many bytes of numbers.
    pub(crate) fn new(bytes: usize) -> Self {
        let asset = Asset {
            generator: Some(concat!("bailando ", env!("CARGO_PKG_VERSION")).into()),
            ..Asset::default()
        };
        Self { root: Root { asset, ..Root::default() }, bytes: Vec::with_capacity(bytes) }
    }

    /// Adds numbers; `bounds` are the least and the largest of each component.
    pub(crate) fn accessor(
        &mut self,
        layout: Layout,
        count: usize,
        bytes: impl IntoIterator<Item = u8>,
        bounds: Option<[Value; 2]>,
    ) -> Index<Accessor> {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        let length = self.bytes.len() - start;
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGNMENT), 0);
        let view = self.root.push(View {
            buffer: Index::new(0),
            byte_length: length.into(),
            byte_offset: Some(start.into()),
            byte_stride: None,
            name: None,
            target: layout.target.map(Valid),
            extensions: None,
            extras: Default::default(),
        });
        let [min, max] = bounds.map_or([None, None], |bounds| bounds.map(Some));
        self.root.push(Accessor {
            buffer_view: Some(view),
            byte_offset: None,
            count: count.into(),
            component_type: Valid(GenericComponentType(layout.component)),
            extensions: None,
            extras: Default::default(),
            type_: Valid(layout.kind),
            min,
            max,
            name: None,
            normalized: layout.normalized,
            sparse: None,
        })
    }

    /// Adds the times of frames in seconds.
    pub(crate) fn times(&mut self, frames: &[usize], fps: u32) -> Index<Accessor> {
        let seconds = |frame: usize| (frame as f64 / f64::from(fps)) as f32;
        let at = |frame: Option<&usize>| json!([seconds(frame.copied().unwrap_or_default())]);
        let bounds = [at(frames.first()), at(frames.last())];
        let bytes = frames.iter().flat_map(|&frame| seconds(frame).to_le_bytes());
        self.accessor(Layout::floats(Type::Scalar), frames.len(), bytes, Some(bounds))
    }

    /// Adds vectors.
    pub(crate) fn vectors(
        &mut self,
        vectors: &[Vec3],
        target: Option<buffer::Target>,
    ) -> Index<Accessor> {
        let least = vectors.iter().copied().reduce(Vec3::min).unwrap_or_default();
        let most = vectors.iter().copied().reduce(Vec3::max).unwrap_or_default();
        let bounds = [least, most].map(|v| json!(v.to_array()));
        let bytes = vectors.iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes);
        let layout = Layout { target, ..Layout::floats(Type::Vec3) };
        self.accessor(layout, vectors.len(), bytes, Some(bounds))
    }

    /// Adds rotations as normalised 16-bit integers: steps of 0.004 degrees in half the bytes.
    pub(crate) fn rotations(&mut self, rotations: &[DQuat]) -> Index<Accessor> {
        let short = |value: f64| (value * SHORT_ONE).round() as i16;
        let numbers = rotations.iter().flat_map(|q| q.to_array().map(short));
        let bytes = numbers.flat_map(i16::to_le_bytes);
        let component = ComponentType::I16;
        let layout = Layout { component, normalized: true, ..Layout::floats(Type::Vec4) };
        self.accessor(layout, rotations.len(), bytes, None)
    }

    /// Adds rotations as floats.
    pub(crate) fn float_rotations(&mut self, rotations: &[DQuat]) -> Index<Accessor> {
        let numbers = rotations.iter().flat_map(|q| q.as_quat().normalize().to_array());
        let bytes = numbers.flat_map(f32::to_le_bytes);
        self.accessor(Layout::floats(Type::Vec4), rotations.len(), bytes, None)
    }

    /// Adds matrices.
    pub(crate) fn matrices(&mut self, matrices: &[Mat4]) -> Index<Accessor> {
        let numbers = matrices.iter().flat_map(Mat4::to_cols_array);
        let bytes = numbers.flat_map(f32::to_le_bytes);
        self.accessor(Layout::floats(Type::Mat4), matrices.len(), bytes, None)
    }

    /// Adds a node for every bone, in their order and before all others, in the rest pose.
    pub(crate) fn bones(&mut self, rig: &Rig) {
        for (index, bone) in rig.bones.iter().enumerate() {
            let children: Vec<Index<Node>> =
                rig.children(index).map(|child| Index::new(child as u32)).collect();
            let turned = bone.rest.angle_between(DQuat::IDENTITY) > 1e-9;
            self.root.push(Node {
                name: Some(bone.name.clone()),
                translation: Some(bone.offset.as_vec3().to_array()),
                rotation: turned
                    .then(|| UnitQuaternion(bone.rest.as_quat().normalize().to_array())),
                children: (!children.is_empty()).then_some(children),
                ..Node::default()
            });
        }
    }

    /// Makes nodes the roots of the scene that is shown.
    pub(crate) fn scene(&mut self, nodes: Vec<Index<Node>>) {
        let (extensions, extras) = (None, Default::default());
        let scene = self.root.push(Scene { name: None, nodes, extensions, extras });
        self.root.scene = Some(scene);
    }

    /// Returns the file.
    ///
    /// # Errors
    /// [`FormatError::TooLong`] beyond the 4 GiB of the container.
    pub(crate) fn into_glb(mut self) -> Result<Vec<u8>, FormatError> {
        self.root.push(Buffer {
            byte_length: self.bytes.len().into(),
            name: None,
            uri: None,
            extensions: None,
            extras: Default::default(),
        });
        let mut json = serde_json::to_vec(&self.root)?;
        json.resize(json.len().next_multiple_of(ALIGNMENT), b' ');
        let length = HEADER + 2 * CHUNK_HEADER + json.len() + self.bytes.len();
        let size = u32::try_from(length);
        let size =
            size.map_err(|_| FormatError::TooLong { format: "glb", bytes: length as u64 })?;
        let mut file = Vec::with_capacity(length);
        file.extend(b"glTF");
        file.extend(2_u32.to_le_bytes());
        file.extend(size.to_le_bytes());
        for (kind, chunk) in [(b"JSON", json), (b"BIN\0", self.bytes)] {
            file.extend((chunk.len() as u32).to_le_bytes());
            file.extend(kind);
            file.extend(chunk);
        }
        Ok(file)
    }
}

/// Adds a track to an animation.
pub(crate) fn push_channel(
    animation: &mut Animation,
    node: usize,
    path: Property,
    [input, output]: [Index<Accessor>; 2],
) {
    let interpolation = Valid(gltf_json::animation::Interpolation::Linear);
    let (extensions, extras) = (None, Default::default());
    animation.samplers.push(Sampler { extensions, extras, input, interpolation, output });
    let (extensions, extras) = (None, Default::default());
    let node = Index::new(node as u32);
    let target = Target { extensions, extras, node, path: Valid(path) };
    let sampler = Index::new(animation.samplers.len() as u32 - 1);
    let (extensions, extras) = (None, Default::default());
    animation.channels.push(Channel { sampler, target, extensions, extras });
}
