//! The codebook of the golden model as numbers, as sheets and as a page.

#![allow(clippy::unwrap_used, reason = "helpers of tests: failing loudly is their job")]

use bailando_codebook::{Catalogue, Half, MEMORY_FILE, Memory, Order, Uses};
use bailando_formats::Codes;
use bailando_model::ModelDirectory;
use bailando_testkit::model::{changed, tiny, tiny_dancer};
use ndarray::Array2;
use serde_json::{Value, json};
use tempfile::TempDir;

const CODES: usize = 16;
/// Joints that the lower half decodes.
const LOWER: [usize; 9] = [0, 1, 2, 4, 5, 7, 8, 10, 11];

/// A model whose name needs care in XML, and another change to its manifest.
fn changed_model(change: impl FnOnce(&mut Value)) -> (TempDir, ModelDirectory) {
    let folder = changed(&tiny(), |manifest| {
        manifest["name"] = "tiny <&> co".into();
        change(manifest);
    });
    let directory = ModelDirectory::open(folder.path()).unwrap();
    (folder, directory)
}

fn model() -> (TempDir, ModelDirectory) {
    changed_model(|_| {})
}

fn catalogue(directory: &ModelDirectory) -> Catalogue {
    Catalogue::new(directory, 1, None, 4).unwrap()
}

fn counted(directory: &ModelDirectory) -> Uses {
    let mut uses = Uses::new(directory.manifest().vocabulary);
    uses.add(&Codes { upper: vec![5, 5, 9, 5, 9, 5], lower: vec![2, 2, 3, 2, 3, 2] }).unwrap();
    uses
}

fn point(value: &Value) -> [f64; 3] {
    serde_json::from_value(value.clone()).unwrap()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// What `text` elements say, in order.
fn labels(svg: &str) -> Vec<&str> {
    let texts = svg.split("<text ").skip(1);
    let content = |text: &'_ str| -> Option<(usize, usize)> {
        Some((text.find('>')? + 1, text.find("</text>")?))
    };
    texts
        .map(|text| {
            let (from, to) = content(text).unwrap();
            text[from..to].trim()
        })
        .collect()
}

fn count(svg: &str, element: &str) -> usize {
    svg.matches(&format!("<{element} ")).count()
}

#[test]
fn every_pose_is_the_middle_of_its_repeated_code() {
    let (_folder, world) = model();
    // Poses are those that are decoded, not yet turned.
    let dancer = ModelDirectory::open(&tiny_dancer()).unwrap();
    for (directory, frame) in [(world, "world"), (dancer, "dancer")] {
        let json = serde_json::to_value(catalogue(&directory)).unwrap();
        assert_eq!(json["motion_frame"], frame);
        assert_eq!(json["skeleton"]["joints"].as_array().unwrap().len(), 24);
        let mut decoder = directory.decoder(1).unwrap();
        let mut still = |upper: usize, lower: usize| -> Array2<f32> {
            let motion = decoder.decode(&[[upper as u32, lower as u32]; 12]).unwrap();
            let mut pose = motion.row(48).iter().copied().take(72).collect::<Vec<_>>();
            // The root's velocity is no part of a pose.
            pose[..3].fill(0.0);
            Array2::from_shape_vec((24, 3), pose).unwrap()
        };
        let neutral = |half: &str| json[half]["neutral"].as_u64().unwrap() as usize;
        let (upper, lower) = (neutral("upper"), neutral("lower"));
        for code in 0..CODES {
            for (half, expected) in [("upper", still(code, lower)), ("lower", still(upper, code))] {
                let entry = &json[half]["codes"][code];
                assert_eq!(entry["code"], code);
                assert!(entry.get("uses").is_none());
                let pose = entry["pose"].as_array().unwrap();
                assert_eq!(pose.len(), 24);
                for (joint, place) in pose.iter().enumerate() {
                    let expected = [0, 1, 2].map(|axis| f64::from(expected[[joint, axis]]));
                    let apart = distance(point(place), expected);
                    assert!(apart < 1e-5, "{frame} {half} {code}, joint {joint}: {apart}");
                }
            }
        }
    }
}

#[test]
fn the_nearest_code_is_at_the_smallest_mean_distance_of_the_halfs_joints() {
    let (_folder, directory) = model();
    let json = serde_json::to_value(catalogue(&directory)).unwrap();
    let upper: Vec<usize> = (0..24).filter(|joint| !LOWER.contains(joint)).collect();
    for (half, joints) in [("upper", &upper[..]), ("lower", &LOWER[1..])] {
        let codes = json[half]["codes"].as_array().unwrap();
        let apart = |a: usize, b: usize| {
            let places = joints.iter().map(|&joint| {
                let [a, b] = [a, b].map(|code| point(&codes[code]["pose"][joint]));
                distance(a, b)
            });
            places.sum::<f64>() / joints.len() as f64
        };
        assert_eq!(codes.len(), CODES);
        for (code, entry) in codes.iter().enumerate() {
            let nearest = &entry["nearest"];
            let found = nearest["distance_m"].as_f64().unwrap();
            let others = (0..CODES).filter(|&other| other != code);
            let best = others.map(|other| apart(code, other)).fold(f64::MAX, f64::min);
            assert!((found - best).abs() < 1e-5, "{half} {code}: {found} {best}");
            let named = nearest["code"].as_u64().unwrap() as usize;
            assert!((apart(code, named) - best).abs() < 1e-5, "{half} {code}: {named}");
        }
    }
}

#[test]
fn a_sheet_has_a_numbered_figure_for_every_code() {
    let (_folder, directory) = model();
    let catalogue = catalogue(&directory);
    for (half, title) in [(Half::Upper, "Upper"), (Half::Lower, "Lower")] {
        let svg = catalogue.sheet(half, 6, Order::Number).unwrap();
        // Three rows of six hold sixteen.
        assert!(svg.starts_with("<svg width=\"960\" height=\"700\""), "{}", &svg[..90]);
        let labels = labels(&svg);
        assert_eq!(labels[0], format!("{title} codes of tiny &lt;&amp;&gt; co"));
        let numbers: Vec<String> = (0..CODES).map(|code| code.to_string()).collect();
        assert_eq!(labels[2..], numbers);
        // Five limbs, the floor and the hand of the dial; the head and the dial.
        assert_eq!(count(&svg, "polyline"), 7 * CODES);
        assert_eq!(count(&svg, "circle"), 2 * CODES);
    }
    // A code in the dancer's frame faces no way, so it has no dial.
    let dancer = ModelDirectory::open(&tiny_dancer()).unwrap();
    let dancer = Catalogue::new(&dancer, 1, None, 4).unwrap();
    let svg = dancer.sheet(Half::Upper, 6, Order::Number).unwrap();
    assert_eq!(count(&svg, "circle"), CODES);
    // A row is never wider than there are codes.
    let svg = catalogue.sheet(Half::Upper, 900, Order::Number).unwrap();
    assert!(svg.starts_with("<svg width=\"2560\" height=\"276\""), "{}", &svg[..90]);
}

#[test]
fn counted_codes_are_labelled_and_sorted_by_use() {
    let (_folder, directory) = model();
    let uses = counted(&directory);
    let catalogue = Catalogue::new(&directory, 1, Some(&uses), 4).unwrap();
    assert_eq!(catalogue.upper.codes[5].uses, Some(4));
    assert_eq!(catalogue.lower.codes[5].uses, Some(0));
    let svg = catalogue.sheet(Half::Upper, 6, Order::Uses).unwrap();
    assert_eq!(labels(&svg)[2..6], ["5 (4×)", "9 (2×)", "0 (0×)", "1 (0×)"]);
    let svg = catalogue.sheet(Half::Lower, 6, Order::Number).unwrap();
    assert_eq!(labels(&svg)[2..6], ["0 (0×)", "1 (0×)", "2 (4×)", "3 (2×)"]);
}

#[test]
fn strips_show_counted_changes_else_start_codes_else_evenly_drawn_ones() {
    let strips = |directory: &ModelDirectory, uses: Option<&Uses>, most| {
        let catalogue = Catalogue::new(directory, 1, uses, most).unwrap();
        let svg = catalogue.transitions_sheet().unwrap();
        // Nine figures of five limbs and a floor each.
        assert_eq!(count(&svg, "polyline"), 54 * catalogue.transitions.len());
        assert_eq!(count(&svg, "circle"), 9 * catalogue.transitions.len());
        labels(&svg)[2..].join(" ")
    };
    let (_folder, directory) = model();
    let uses = counted(&directory);
    let counted = "5 / 2 → 9 / 3 2× 9 / 3 → 5 / 2 2×";
    assert_eq!(strips(&directory, Some(&uses), 4), counted);
    assert_eq!(strips(&directory, None, 2), "0 / 0 → 8 / 8 8 / 8 → 0 / 0");

    let (_folder, directory) = changed_model(|manifest| {
        manifest["start_codes"] = json!([[1, 2], [3, 4], [3, 4], [5, 6]]);
    });
    let drawn = "1 / 2 → 3 / 4 3 / 4 → 5 / 6 5 / 6 → 1 / 2";
    assert_eq!(strips(&directory, None, 9), drawn);
}

#[test]
fn the_page_holds_every_sheet_and_needs_nothing_else() {
    let (_folder, directory) = model();
    let catalogue = catalogue(&directory);
    let page = catalogue.page(4, Order::Number).unwrap();
    for sheet in [
        catalogue.sheet(Half::Upper, 4, Order::Number).unwrap(),
        catalogue.sheet(Half::Lower, 4, Order::Number).unwrap(),
        catalogue.transitions_sheet().unwrap(),
    ] {
        assert!(page.contains(&sheet));
    }
    assert!(page.contains("<h1>Codebook of tiny &lt;&amp;&gt; co</h1>"));
    for reference in ["src=", "href=", "url(", "@import"] {
        assert!(!page.contains(reference), "{reference}");
    }
}

#[test]
fn a_memory_is_read_with_its_own_model_only() {
    let (folder, directory) = model();
    assert_eq!(Memory::read(&directory).unwrap(), None);
    let memory = Memory::new(&counted(&directory), directory.manifest_sha256());
    let write = |memory: &Memory| {
        let text = serde_json::to_string(memory).unwrap();
        std::fs::write(folder.path().join(MEMORY_FILE), text).unwrap();
    };
    write(&memory);
    assert_eq!(Memory::read(&directory).unwrap(), Some(memory.clone()));
    write(&Memory { manifest_sha256: "other".into(), ..memory });
    let error = Memory::read(&directory).unwrap_err().to_string();
    assert!(error.ends_with("memory.json: it counts the codes of another model"), "{error}");
}
