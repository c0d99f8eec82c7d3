//! What stands before and after the objects of an FBX file: origin, axes, units, times, counts.

use super::records::{Records, VERSION, Value};
use crate::glb::TAKE;

/// Ticks of FBX per second.
pub(super) const TICKS: i64 = 46_186_158_000;
/// The time that every file names as that of its creation, so that equal motions are equal files.
const CREATED: &str = "1970-01-01 10:00:00:000";
const FILE_ID: [u8; 16] = [
    0x28, 0xb3, 0x2a, 0xeb, 0xb6, 0x24, 0xcc, 0xc2, 0xbf, 0xc8, 0xb0, 0x2a, 0xa9, 0x2b, 0xfc, 0xf1,
];
const CREATOR: &str = concat!("bailando ", env!("CARGO_PKG_VERSION"));
/// Number of the document.
const DOCUMENT: i64 = 7_000_000;

/// Time of a motion.
#[derive(Clone, Copy)]
pub(super) struct Span {
    pub(super) fps: u32,
    /// Ticks of the last frame.
    pub(super) stop: i64,
}

/// Adds a property of an object.
pub(super) fn property(records: &mut Records, kind: [&str; 4], values: &[Value<'_>]) {
    let mut all: Vec<Value<'_>> = kind.iter().map(|text| Value::Text(text)).collect();
    all.extend(values);
    records.leaf("P", &all);
}

pub(super) fn int(records: &mut Records, name: &str, value: i32) {
    property(records, [name, "int", "Integer", ""], &[Value::Int(value)]);
}

pub(super) fn choice(records: &mut Records, name: &str, value: i32) {
    property(records, [name, "enum", "", ""], &[Value::Int(value)]);
}

pub(super) fn double(records: &mut Records, name: &str, value: f64) {
    property(records, [name, "double", "Number", ""], &[Value::Double(value)]);
}

pub(super) fn time(records: &mut Records, name: &str, ticks: i64) {
    property(records, [name, "KTime", "Time", ""], &[Value::Long(ticks)]);
}

/// Writes origin, axes, units, frame rate, and how many objects there are of each type.
pub(super) fn begin(records: &mut Records, span: Span, counts: &[(&str, usize)]) {
    records.node("FBXHeaderExtension", &[], |records| {
        records.leaf("FBXHeaderVersion", &[Value::Int(1003)]);
        records.leaf("FBXVersion", &[Value::Int(VERSION as i32)]);
        records.leaf("EncryptionType", &[Value::Int(0)]);
        records.leaf("Creator", &[Value::Text(CREATOR)]);
    });
    records.leaf("FileId", &[Value::Raw(&FILE_ID)]);
    records.leaf("CreationTime", &[Value::Text(CREATED)]);
    records.leaf("Creator", &[Value::Text(CREATOR)]);
    records.node("GlobalSettings", &[], |records| {
        records.leaf("Version", &[Value::Int(1000)]);
        records.node("Properties70", &[], |records| settings(records, span));
    });
    records.node("Documents", &[], |records| {
        records.leaf("Count", &[Value::Int(1)]);
        let document = [Value::Long(DOCUMENT), Value::Text("Scene"), Value::Text("Scene")];
        records.node("Document", &document, |records| {
            records.node("Properties70", &[], |records| {
                let kind = ["ActiveAnimStackName", "KString", "", ""];
                property(records, kind, &[Value::Text(TAKE)]);
            });
            records.leaf("RootNode", &[Value::Long(0)]);
        });
    });
    records.node("References", &[], |_| {});
    records.node("Definitions", &[], |records| {
        let all: usize = counts.iter().map(|(_, count)| count).sum();
        records.leaf("Version", &[Value::Int(100)]);
        records.leaf("Count", &[Value::Int(all as i32 + 1)]);
        for &(kind, count) in [("GlobalSettings", 1)].iter().chain(counts) {
            records.node("ObjectType", &[Value::Text(kind)], |records| {
                records.leaf("Count", &[Value::Int(count as i32)]);
            });
        }
    });
}

/// y up, right-handed, heading for +z, centimetres.
fn settings(records: &mut Records, span: Span) {
    for (axis, number) in [("UpAxis", 1), ("FrontAxis", 2), ("CoordAxis", 0)] {
        int(records, axis, number);
        int(records, &format!("{axis}Sign"), 1);
    }
    int(records, "OriginalUpAxis", 1);
    int(records, "OriginalUpAxisSign", 1);
    double(records, "UnitScaleFactor", 1.0);
    double(records, "OriginalUnitScaleFactor", 1.0);
    let mode = match span.fps {
        60 => 3,
        30 => 6,
        24 => 11,
        // Any other, which CustomFrameRate names.
        _ => 14,
    };
    choice(records, "TimeMode", mode);
    time(records, "TimeSpanStart", 0);
    time(records, "TimeSpanStop", span.stop);
    double(records, "CustomFrameRate", f64::from(span.fps));
}

/// Writes the list of takes, which is the one motion.
pub(super) fn takes(records: &mut Records, span: Span) {
    records.node("Takes", &[], |records| {
        records.leaf("Current", &[Value::Text(TAKE)]);
        records.node("Take", &[Value::Text(TAKE)], |records| {
            records.leaf("FileName", &[Value::Text(&format!("{TAKE}.tak"))]);
            for name in ["LocalTime", "ReferenceTime"] {
                records.leaf(name, &[Value::Long(0), Value::Long(span.stop)]);
            }
        });
    });
}
