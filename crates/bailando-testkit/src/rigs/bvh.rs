//! A body as a BVH file.

use std::fmt::Write;

use super::Body;

/// Orders of channels, taken in turn.
const ORDERS: [&str; 3] = [
    "Zrotation Xrotation Yrotation",
    "Xrotation Yrotation Zrotation",
    "Yrotation Zrotation Xrotation",
];

/// Writes a body with one frame, so many units a metre. Lines end with CR LF, and there are blanks
/// that nobody needs.
pub fn bvh(body: &Body, unit: f64) -> String {
    let mut text = String::from("HIERARCHY\r\n");
    joint(&mut text, body, 0, 0, unit);
    let numbers = 6 * body.bones.len();
    text.push_str("MOTION\r\nFrames:\t1\r\nFrame Time:  0.04\r\n");
    text.push_str(&vec!["0.0"; numbers].join(" "));
    text.push_str("\r\n");
    text
}

fn joint(text: &mut String, body: &Body, at: usize, depth: usize, unit: f64) {
    let bone = &body.bones[at];
    let tabs = "\t".repeat(depth);
    let kind = if depth == 0 { "ROOT" } else { "JOINT" };
    let parent = bone.parent.map_or(glam::DVec3::ZERO, |parent| body.bones[parent].place);
    let offset = (bone.place - parent) * unit;
    let order = ORDERS[at % ORDERS.len()];
    write!(
        text,
        "{tabs}{kind} {}\r\n{tabs}{{\r\n{tabs}\tOFFSET {:.6}  {:.6} {:.6}\r\n{tabs}\tCHANNELS 6 \
         Xposition Yposition Zposition {order} \r\n",
        bone.name, offset.x, offset.y, offset.z
    )
    .unwrap();
    let mut is_leaf = true;
    for child in 0..body.bones.len() {
        if body.bones[child].parent == Some(at) {
            is_leaf = false;
            joint(text, body, child, depth + 1, unit);
        }
    }
    if is_leaf {
        let end = offset * 0.5;
        let (x, y, z) = (end.x, end.y, end.z);
        write!(
            text,
            "{tabs}\tEnd Site {{\r\n{tabs}\t\tOFFSET {x:.4} {y:.4} {z:.4}\r\n{tabs}\t}}\r\n"
        )
        .unwrap();
    }
    write!(text, "{tabs}}}\r\n").unwrap();
}
