//! A body as a GLB or VRM file: nodes, a skin, a triangle, and things that nobody may touch.

use glam::{DMat4, DQuat, DVec3};
use serde_json::{Map, Value, json};

use super::Body;

/// What names the humanoid's bones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Humanoid {
    /// Nothing but their names.
    #[default]
    None,
    /// VRM 0.x.
    Vrm0,
    /// VRM 1.0.
    Vrm1,
}

/// How a body is written.
#[derive(Clone, Debug, Default)]
pub struct Glb {
    /// Scale and rotation of a node above all bones.
    pub armature: Option<(f64, DQuat)>,
    /// Who says which bones there are.
    pub humanoid: Humanoid,
    /// Whether transforms are matrices.
    pub matrices: bool,
    /// Names of nodes beside the body.
    pub extra: Vec<String>,
}

/// Names of VRM for the parts of a body.
const HUMAN: [(&str, &str); 22] = [
    ("hips", "hips"),
    ("spine", "spine"),
    ("chest", "chest"),
    ("upper_chest", "upperChest"),
    ("neck", "neck"),
    ("head", "head"),
    ("l_shoulder", "leftShoulder"),
    ("l_upper_arm", "leftUpperArm"),
    ("l_lower_arm", "leftLowerArm"),
    ("l_hand", "leftHand"),
    ("l_upper_leg", "leftUpperLeg"),
    ("l_lower_leg", "leftLowerLeg"),
    ("l_foot", "leftFoot"),
    ("l_toes", "leftToes"),
    ("r_shoulder", "rightShoulder"),
    ("r_upper_arm", "rightUpperArm"),
    ("r_lower_arm", "rightLowerArm"),
    ("r_hand", "rightHand"),
    ("r_upper_leg", "rightUpperLeg"),
    ("r_lower_leg", "rightLowerLeg"),
    ("r_foot", "rightFoot"),
    ("r_toes", "rightToes"),
];

/// Writes a body as GLB.
pub fn glb(body: &Body, how: &Glb) -> Vec<u8> {
    let (scale, turn) = how.armature.unwrap_or((1.0, DQuat::IDENTITY));
    let first = 2;
    let mut nodes = vec![
        json!({ "name": "Body", "mesh": 0, "skin": 0 }),
        json!({
            "name": "Armature", "scale": [scale, scale, scale], "rotation": turn.to_array(),
            "children": [first],
        }),
    ];
    for bone in &body.bones {
        let (above, around, scale) = match bone.parent {
            Some(parent) => (body.bones[parent].place, body.bones[parent].axes, scale),
            None => (DVec3::ZERO, turn, scale),
        };
        let place = around.inverse() * (bone.place - above) / scale;
        let local = around.inverse() * bone.axes;
        let mut node = match how.matrices {
            true => json!({
                "matrix": DMat4::from_rotation_translation(local, place).to_cols_array().to_vec(),
            }),
            false => json!({ "translation": place.to_array(), "rotation": local.to_array() }),
        };
        node["name"] = json!(bone.name);
        nodes.push(node);
    }
    for (at, bone) in body.bones.iter().enumerate() {
        if let Some(parent) = bone.parent {
            let children = nodes[first + parent].as_object_mut().unwrap();
            let children = children.entry("children").or_insert_with(|| json!([]));
            children.as_array_mut().unwrap().push(json!(first + at));
        }
    }
    for name in &how.extra {
        let at = nodes.len();
        nodes.push(json!({ "name": name, "translation": [0.1, 0.0, 0.2] }));
        let armature = nodes[1]["children"].as_array_mut().unwrap();
        armature.push(json!(at));
    }
    let joints: Vec<usize> = (first..first + body.bones.len()).collect();
    let mut binary: Vec<u8> = Vec::new();
    for number in [0.0_f32, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1, 0.0] {
        binary.extend(number.to_le_bytes());
    }
    // A buffer need not fill its chunk.
    binary.extend([1, 2, 3, 4, 5]);
    let extensions = extensions(body, how.humanoid, first);
    let used: Vec<&String> = extensions.keys().collect();
    let rest = json!({
        "asset": { "version": "2.0", "generator": "a test" },
        "scene": 0,
        "scenes": [{ "nodes": [1, 0] }],
        "skins": [{ "joints": joints }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "buffers": [{ "byteLength": binary.len() }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "extensionsUsed": used,
        "extensions": extensions,
        "nodes": nodes,
    });
    // Numbers as programs write them, which no reader and writer would leave as they are.
    let odd = concat!(
        "{ \"extras\": { \"secret\": 1.10, \"big\": 12345678901234567890123, \"e\":1.50e-0 },\n",
        "\t\"accessors\" : [ {\"bufferView\":0, \"componentType\":5126, \"count\":3, ",
        "\"type\":\"VEC3\", \"min\":[0,0,0], \"max\":[0.100,0.10,0.0] } ] ,"
    );
    let rest = rest.to_string();
    container(&format!("{odd}{}", &rest[1..]), &binary)
}

fn extensions(body: &Body, humanoid: Humanoid, first: usize) -> Map<String, Value> {
    let node = |part: &str| first + body.bones.iter().position(|b| b.part == part).unwrap();
    let mut all = Map::new();
    match humanoid {
        Humanoid::None => {}
        Humanoid::Vrm0 => {
            let bone = |(part, name): (&str, &str)| json!({ "bone": name, "node": node(part) });
            let mut bones: Vec<Value> = HUMAN.into_iter().map(bone).collect();
            bones.push(json!({ "bone": "jaw", "node": -1 }));
            let content = json!({ "humanoid": { "humanBones": bones } });
            all.insert("VRM".into(), content);
        }
        Humanoid::Vrm1 => {
            let bone = |(part, name): (&str, &str)| (name.into(), json!({ "node": node(part) }));
            let bones: Map<String, Value> = HUMAN.into_iter().map(bone).collect();
            let content = json!({ "specVersion": "1.0", "humanoid": { "humanBones": bones } });
            all.insert("VRMC_vrm".into(), content);
        }
    }
    all
}

/// Puts a GLB together; without a binary chunk if that would be empty.
pub fn container(json: &str, binary: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut file = b"glTF\x02\0\0\0".to_vec();
    let mut chunks = vec![(b"JSON", &json), (b"BIN\0", &binary)];
    chunks.retain(|(_, chunk)| !chunk.is_empty());
    let length = 12 + chunks.iter().map(|(_, chunk)| 8 + chunk.len()).sum::<usize>();
    file.extend((length as u32).to_le_bytes());
    for (kind, chunk) in chunks {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    file
}
