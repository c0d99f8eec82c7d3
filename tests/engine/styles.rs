//! A model that knows styles and energies: what may be asked for, what is given to it, and what
//! the answer says.

use bailando::{
    engine::{Engine, GenerationOptions, GenerationRequest},
    formats::Codes,
};
use bailando_testkit::model::{changed, tiny, tiny_styles};
use ndarray::Array2;

use super::open;
use crate::support::music;

const STYLES: [&str; 3] = ["house", "krump", "lock"];

fn options(style: Option<&str>) -> GenerationOptions {
    // The most likely codes, from the same first ones.
    GenerationOptions {
        style: style.map(str::to_owned),
        seed: Some(1),
        temperature: Some(0.0),
        ..GenerationOptions::default()
    }
}

fn rows(engine: &Engine) -> Array2<f32> {
    music(40, engine.manifest().features.columns)
}

fn generated(
    engine: &Engine,
    music: Array2<f32>,
    options: &GenerationOptions,
) -> (Codes, Option<String>) {
    let output = engine.generate(GenerationRequest::features(music, options.clone())).unwrap();
    (output.codes, output.style)
}

#[test]
fn every_style_and_energy_is_another_dance() {
    let engine = open(&tiny_styles()).unwrap();
    assert_eq!(engine.manifest().styles, STYLES);
    let asked = STYLES.into_iter().chain(["mixed"]);
    let mut dances: Vec<Codes> = Vec::new();
    for style in asked {
        let (codes, named) = generated(&engine, rows(&engine), &options(Some(style)));
        assert_eq!(named.as_deref(), Some(style));
        assert!(!dances.contains(&codes), "{style} is danced like another");
        let energetic = GenerationOptions { energy: Some(0.9), ..options(Some(style)) };
        assert_ne!(generated(&engine, rows(&engine), &energetic).0, codes, "{style}");
        dances.push(codes);
    }
}

#[test]
fn auto_takes_the_style_of_the_music_where_it_is_clear() {
    let engine = open(&tiny_styles()).unwrap();
    for (column, style) in [(0, "house"), (1, "krump"), (2, "lock"), (3, "mixed")] {
        let mut music = rows(&engine);
        music.column_mut(column).mapv_inplace(|value| value + 4.0);
        let (codes, named) = generated(&engine, music.clone(), &options(None));
        assert_eq!(named.as_deref(), Some(style));
        let asked = |style| generated(&engine, music.clone(), &options(Some(style)));
        assert_eq!(codes, asked(style).0);
        assert_eq!(asked("auto").1.as_deref(), Some(style));
    }
}

#[test]
fn guidance_strengthens_the_style() {
    let engine = open(&tiny_styles()).unwrap();
    let guided = |style, guidance| {
        let options = GenerationOptions { guidance: Some(guidance), ..options(Some(style)) };
        generated(&engine, rows(&engine), &options).0
    };
    // With nothing but the branch that is told no style, all styles are one.
    assert_eq!(guided("house", 0.0), guided("lock", 0.0));
    assert_ne!(guided("house", 1.0), guided("lock", 1.0));
    assert_ne!(guided("house", 4.0), guided("house", 1.0));
}

#[test]
fn what_a_model_does_not_know_is_refused_with_what_it_knows() {
    let engine = open(&tiny_styles()).unwrap();
    let refused = |engine: &Engine, options: GenerationOptions| {
        engine.check(&options).map(drop).unwrap_err().to_string()
    };
    let said = refused(&engine, options(Some("waltz")));
    assert!(said.contains("\"waltz\" is not one of auto, mixed, house, krump, lock"), "{said}");
    let energy = |energy| GenerationOptions { energy: Some(energy), ..options(None) };
    assert!(refused(&engine, energy(1.5)).contains("not between 0 and 1"));

    let plain = open(&tiny()).unwrap();
    for style in ["house", "mixed"] {
        let said = refused(&plain, options(Some(style)));
        assert!(said.ends_with("this model has no styles"), "{said}");
    }
    assert!(refused(&plain, energy(0.5)).contains("cannot be asked"));
    let (codes, style) = generated(&plain, rows(&plain), &options(Some("auto")));
    assert_eq!((codes, style), generated(&plain, rows(&plain), &options(None)));
}

#[test]
fn a_classifier_of_other_styles_stops_the_start() {
    let folder = changed(&tiny_styles(), |manifest| {
        manifest["styles"] = serde_json::json!(["house", "lock", "krump"]);
    });
    let said = open(folder.path()).unwrap_err().to_string();
    assert!(said.contains("styles.json") && said.contains("not the manifest's"), "{said}");
    let folder = changed(&tiny_styles(), |manifest| {
        manifest["files"].as_object_mut().unwrap().remove("styles.json");
    });
    let engine = open(folder.path()).unwrap();
    let (_, style) = generated(&engine, rows(&engine), &options(None));
    assert_eq!(style.as_deref(), Some("mixed"));
}

/// A dance that began in another style, or came upon its codes, would go on in it.
#[test]
fn a_dance_begins_as_its_style_does_and_keeps_to_its_codes() {
    let folder = changed(&tiny_styles(), |manifest| {
        manifest["start_codes"] = serde_json::json!([[3, 5], [9, 1]]);
        manifest["style_start_codes"] = serde_json::json!({"house": [[9, 1]]});
        manifest["style_codes"] =
            serde_json::json!({"house": {"upper": [2, 3, 9], "lower": [1, 5]}});
    });
    let engine = open(folder.path()).unwrap();
    let dances = |style: &str| {
        let dances = (0..12).map(|seed| {
            let options = GenerationOptions { seed: Some(seed), ..options(Some(style)) };
            generated(&engine, rows(&engine), &options).0
        });
        dances.collect::<Vec<_>>()
    };
    let of_house = dances("house");
    assert!(of_house.iter().all(|codes| [codes.upper[0], codes.lower[0]] == [9, 1]));
    for codes in &of_house {
        assert!(codes.upper.iter().all(|code| [2, 3, 9].contains(code)), "{codes:?}");
        assert!(codes.lower.iter().all(|code| [1, 5].contains(code)), "{codes:?}");
    }
    for other in ["lock", "mixed"].map(dances) {
        assert!(other.iter().any(|codes| codes.upper[0] == 3));
        assert!(other.iter().flat_map(|codes| &codes.lower).any(|code| ![1, 5].contains(code)));
    }
}

#[test]
fn codes_of_styles_that_make_no_sense_stop_the_start() {
    let nothing = serde_json::json!({});
    for (starts, codes, says) in [
        (serde_json::json!({"tango": [[9, 1]]}), &nothing, "style_start_codes has \"tango\""),
        (serde_json::json!({"house": [[1, 9]]}), &nothing, "1, 9 of house are none of start_codes"),
        (
            nothing.clone(),
            &serde_json::json!({"tango": {"upper": [1], "lower": [1]}}),
            "style_codes has \"tango\"",
        ),
        (
            nothing.clone(),
            &serde_json::json!({"lock": {"upper": [1], "lower": [2, 1]}}),
            "style_codes of lock are not ascending",
        ),
        (
            nothing.clone(),
            &serde_json::json!({"lock": {"upper": [1], "lower": []}}),
            "style_codes leave lock nothing to draw",
        ),
    ] {
        let folder = changed(&tiny_styles(), |manifest| {
            manifest["start_codes"] = serde_json::json!([[9, 1]]);
            manifest["style_start_codes"] = starts;
            manifest["style_codes"] = codes.clone();
        });
        let said = open(folder.path()).unwrap_err().to_string();
        assert!(said.contains(says), "{said}");
    }
}
