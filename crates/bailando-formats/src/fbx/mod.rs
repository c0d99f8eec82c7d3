//! FBX, binary 7.4: bones and their animation, without a mesh.
//!
//! y up, right-handed, heading for +z, centimetres. A bone's rest rotation is its `PreRotation`;
//! its curves turn it from there, by angles in an order of its own. There is a key at every frame.

mod head;
mod records;

use bailando_motion::Animation;
use glam::{DQuat, DVec3};

use self::{
    head::{Span, TICKS, choice, double, property, time},
    records::{Records, Value},
};
use crate::{
    error::FormatError,
    euler::RotationOrder,
    glb::TAKE,
    motion::{GeneratedMotion, MotionSize},
    rig::Rig,
    target::TargetSkeleton,
};

/// Numbers of objects: that of a bone is added.
const ATTRIBUTE: i64 = 1_000_000;
const MODEL: i64 = 2_000_000;
const ROTATION: i64 = 3_000_000;
const CURVE: i64 = 4_000_000;
const STACK: i64 = 5_000_000;
const LAYER: i64 = 5_000_001;
const TRANSLATION: i64 = 5_000_002;
const PATH: i64 = 5_000_003;
const CENTIMETRES: f64 = 100.0;
/// Flags of a key that is joined to the next by a straight line.
const LINEAR: i32 = 0x6104;
/// Version of keys.
const KEYS: i32 = 4009;
/// Bytes of a key: time and value.
const KEY_BYTES: usize = 12;

/// About the most bytes of a motion as FBX.
pub(crate) fn fbx_bytes(size: MotionSize) -> usize {
    let joints = size.joints + 1;
    8192 + 4096 * joints + 3 * KEY_BYTES * (joints + 1) * size.frames
}

/// Writes a motion as FBX on a skeleton that characters and programs know.
///
/// # Errors
/// [`FormatError::Inconsistent`] if its parts do not fit each other or hold a NaN or an infinity,
/// [`FormatError::Skeleton`] if the model has joints that the target does not know.
pub fn to_fbx(motion: &GeneratedMotion, target: TargetSkeleton) -> Result<Vec<u8>, FormatError> {
    motion.check()?;
    let rig = Rig::new(&motion.skeleton, target, true)?;
    let animation = &motion.animation;
    let ticks = TICKS / i64::from(animation.fps);
    let times: Vec<i64> = (0..animation.root.len() as i64).map(|frame| frame * ticks).collect();
    let span = Span { fps: animation.fps, stop: times.last().copied().unwrap_or_default() };
    let moving: Vec<usize> =
        (0..rig.bones.len()).filter(|&bone| !rig.is_still(bone, &animation.rotations)).collect();
    let scene = Scene { motion, rig: &rig, moving: &moving, times: &times };

    let mut records = Records::new(fbx_bytes(motion.size()));
    let bones = rig.bones.len();
    let counts = [
        ("NodeAttribute", bones),
        ("Model", bones),
        ("AnimationStack", 1),
        ("AnimationLayer", 1),
        ("AnimationCurveNode", moving.len() + 1),
        ("AnimationCurve", 3 * (moving.len() + 1)),
    ];
    head::begin(&mut records, span, &counts);
    records.node("Objects", &[], |records| {
        scene.bones(records);
        scene.take(records, span);
        scene.path(records);
        moving.iter().for_each(|&bone| scene.rotation(records, bone));
    });
    records.node("Connections", &[], |records| scene.connections(records));
    head::takes(&mut records, span);
    records.finish()
}

struct Scene<'a> {
    motion: &'a GeneratedMotion,
    rig: &'a Rig,
    /// Bones that have curves.
    moving: &'a [usize],
    /// Ticks of every frame.
    times: &'a [i64],
}

/// Returns the name of an object as binary files write it.
fn named(name: &str, class: &str) -> String {
    format!("{name}\0\u{1}{class}")
}

impl Scene<'_> {
    fn animation(&self) -> &Animation {
        &self.motion.animation
    }

    fn bones(&self, records: &mut Records) {
        for (index, bone) in self.rig.bones.iter().enumerate() {
            let number = index as i64;
            let name = named(&bone.name, "NodeAttribute");
            let values = [Value::Long(ATTRIBUTE + number), Value::Text(&name), LIMB];
            records.node("NodeAttribute", &values, |records| {
                records.node("Properties70", &[], |records| double(records, "Size", 1.0));
                records.leaf("TypeFlags", &[Value::Text("Skeleton")]);
            });
            let name = named(&bone.name, "Model");
            let values = [Value::Long(MODEL + number), Value::Text(&name), LIMB];
            records.node("Model", &values, |records| {
                records.leaf("Version", &[Value::Int(232)]);
                records.node("Properties70", &[], |records| {
                    let rest = RotationOrder::XYZ.nearest_angles(bone.rest, [0.0; 3]);
                    // XYZ of FBX turns about x first: z comes first in the product.
                    let [z, y, x] = rest.map(f64::to_degrees);
                    choice(records, "RotationOrder", self.order(index).1);
                    vector(records, ["PreRotation", "Vector3D", "Vector", ""], [x, y, z]);
                    let active = ["RotationActive", "bool", "", ""];
                    property(records, active, &[Value::Int(1)]);
                    choice(records, "InheritType", 1);
                    let offset = (bone.offset * CENTIMETRES).to_array();
                    vector(records, ["Lcl Translation", "Lcl Translation", "", "A"], offset);
                    vector(records, ["Lcl Rotation", "Lcl Rotation", "", "A"], [0.0; 3]);
                });
                records.leaf("Shading", &[Value::Short(1)]);
                records.leaf("Culling", &[Value::Text("CullingOff")]);
            });
        }
    }

    /// Returns the order of a bone's angles about its own axes, which is that of its joint about
    /// the nearest axes of the world, and its number in FBX.
    fn order(&self, bone: usize) -> (RotationOrder, i32) {
        let joint = self.rig.bones[bone].joint;
        let joint = joint.and_then(|joint| self.motion.skeleton.joints.get(joint));
        let order = RotationOrder::of_joint(joint.map_or("", String::as_str));
        let axes = self.rig.nearest_axes(bone);
        let order = RotationOrder(order.0.map(|axis| axes[axis]));
        // FBX names the order in which the turns are made: the product from right to left.
        let number = match order.0 {
            [2, 1, 0] => 0,
            [1, 2, 0] => 1,
            [0, 2, 1] => 2,
            [2, 0, 1] => 3,
            [1, 0, 2] => 4,
            [0, 1, 2] => 5,
            // Two axes of the world are nearest to one of the bone: any order will do.
            _ => return (RotationOrder::XYZ, 0),
        };
        (order, number)
    }

    fn take(&self, records: &mut Records, span: Span) {
        let name = named(TAKE, "AnimStack");
        let stack = [Value::Long(STACK), Value::Text(&name), Value::Text("")];
        records.node("AnimationStack", &stack, |records| {
            records.node("Properties70", &[], |records| {
                for edge in ["Local", "Reference"] {
                    time(records, &format!("{edge}Start"), 0);
                    time(records, &format!("{edge}Stop"), span.stop);
                }
            });
        });
        let name = named("BaseLayer", "AnimLayer");
        let layer = [Value::Long(LAYER), Value::Text(&name), Value::Text("")];
        records.node("AnimationLayer", &layer, |_| {});
    }

    fn path(&self, records: &mut Records) {
        let places = self.animation().root.iter();
        let places: Vec<DVec3> = places.map(|&root| self.rig.place(root) * CENTIMETRES).collect();
        self.curves(records, [TRANSLATION, PATH], "T", &places);
    }

    fn rotation(&self, records: &mut Records, bone: usize) {
        let (order, _) = self.order(bone);
        let into_rest = self.rig.bones[bone].rest.inverse();
        let mut angles = [0.0; 3];
        let frames = self.animation().rotations.iter().map(|frame| {
            let turn: DQuat = into_rest * self.rig.rotation(bone, frame);
            angles = order.nearest_angles(turn, angles);
            let mut about = DVec3::ZERO;
            for (axis, angle) in order.0.into_iter().zip(angles) {
                about[axis] = angle.to_degrees();
            }
            about
        });
        let frames: Vec<DVec3> = frames.collect();
        let number = bone as i64;
        self.curves(records, [ROTATION + number, CURVE + 3 * number], "R", &frames);
    }

    /// Adds the three curves of a vector, the first of them numbered `first`.
    fn curves(
        &self,
        records: &mut Records,
        [node, first]: [i64; 2],
        letter: &str,
        frames: &[DVec3],
    ) {
        let start = frames.first().copied().unwrap_or_default();
        let name = named(letter, "AnimCurveNode");
        let values = [Value::Long(node), Value::Text(&name), Value::Text("")];
        records.node("AnimationCurveNode", &values, |records| {
            records.node("Properties70", &[], |records| {
                for (axis, start) in AXES.into_iter().zip(start.to_array()) {
                    property(records, [axis, "Number", "", "A"], &[Value::Double(start)]);
                }
            });
        });
        let name = named("", "AnimCurve");
        for axis in 0..AXES.len() {
            let numbers: Vec<f32> = frames.iter().map(|frame| frame[axis] as f32).collect();
            let values = [Value::Long(first + axis as i64), Value::Text(&name), Value::Text("")];
            records.node("AnimationCurve", &values, |records| {
                records.leaf("Default", &[Value::Double(start[axis])]);
                records.leaf("KeyVer", &[Value::Int(KEYS)]);
                records.leaf("KeyTime", &[Value::Longs(self.times)]);
                records.leaf("KeyValueFloat", &[Value::Floats(&numbers)]);
                // Flags and tangents of all keys together.
                records.leaf("KeyAttrFlags", &[Value::Ints(&[LINEAR])]);
                records.leaf("KeyAttrDataFloat", &[Value::Floats(&[0.0; 4])]);
                records.leaf("KeyAttrRefCount", &[Value::Ints(&[numbers.len() as i32])]);
            });
        }
    }

    fn connections(&self, records: &mut Records) {
        let mut join = |kind: &str, from: i64, to: i64, property: Option<&str>| {
            let mut values = vec![Value::Text(kind), Value::Long(from), Value::Long(to)];
            values.extend(property.map(Value::Text));
            records.leaf("C", &values);
        };
        for (index, bone) in self.rig.bones.iter().enumerate() {
            let number = index as i64;
            // 0 is the scene.
            let above = bone.parent.map_or(0, |parent| MODEL + parent as i64);
            join("OO", MODEL + number, above, None);
            join("OO", ATTRIBUTE + number, MODEL + number, None);
        }
        join("OO", LAYER, STACK, None);
        let hips = (TRANSLATION, PATH, self.rig.hips(), "Lcl Translation");
        let turns = self.moving.iter().map(|&bone| {
            let number = bone as i64;
            (ROTATION + number, CURVE + 3 * number, bone, "Lcl Rotation")
        });
        for (node, first, bone, property) in [hips].into_iter().chain(turns) {
            join("OO", node, LAYER, None);
            join("OP", node, MODEL + bone as i64, Some(property));
            for (axis, name) in AXES.into_iter().enumerate() {
                join("OP", first + axis as i64, node, Some(name));
            }
        }
    }
}

const AXES: [&str; 3] = ["d|X", "d|Y", "d|Z"];
const LIMB: Value<'_> = Value::Text("LimbNode");

fn vector(records: &mut Records, kind: [&str; 4], numbers: [f64; 3]) {
    property(records, kind, &numbers.map(Value::Double));
}
