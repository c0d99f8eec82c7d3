//! What an option accepts: checked, described, and written as a schema.

use std::fmt;

use crate::formats::Continuation;
use utoipa::openapi::schema::{Object, ObjectBuilder, Type};

/// What an option accepts.
#[derive(Clone, Copy)]
pub(super) enum Accepts {
    Words(&'static [&'static str]),
    IntegerOf(&'static [u32]),
    /// From `least` to `most`.
    Integer {
        least: u64,
        most: u64,
    },
    /// From 0 to `most`.
    Number {
        most: f64,
    },
    /// Above 0.
    PositiveNumber,
    Boolean,
    /// The end of a dance.
    Continuation,
}

impl Accepts {
    pub(super) fn admits(self, text: &str) -> bool {
        let number = || text.parse::<f64>().ok().filter(|value| value.is_finite());
        match self {
            Self::Words(words) => words.contains(&text),
            Self::IntegerOf(values) => text.parse().is_ok_and(|value| values.contains(&value)),
            Self::Integer { least, most } => text
                .parse::<u64>()
                .is_ok_and(|value| (least..=most).contains(&value)),
            Self::Number { most } => number().is_some_and(|value| (0.0..=most).contains(&value)),
            Self::PositiveNumber => number().is_some_and(|value| value > 0.0),
            Self::Boolean => text.parse::<bool>().is_ok(),
            Self::Continuation => text.parse::<Continuation>().is_ok(),
        }
    }

    pub(super) fn schema(self) -> Object {
        let of = |kind: Type| ObjectBuilder::new().schema_type(kind);
        match self {
            Self::Words(words) => of(Type::String).enum_values(Some(words.iter().copied())),
            Self::IntegerOf(values) => of(Type::Integer).enum_values(Some(values.iter().copied())),
            Self::Integer { least, most } => {
                of(Type::Integer).minimum(Some(least)).maximum(Some(most))
            }
            Self::Number { most } if most == f64::MAX => of(Type::Number).minimum(Some(0)),
            Self::Number { most } => of(Type::Number).minimum(Some(0)).maximum(Some(most)),
            Self::PositiveNumber => of(Type::Number).exclusive_minimum(Some(0)),
            Self::Boolean => of(Type::Boolean),
            Self::Continuation => of(Type::String).pattern(Some("^[A-Za-z0-9_-]{28,256}$")),
        }
        .build()
    }
}

impl fmt::Display for Accepts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Words(words) => match words {
                [word] => f.write_str(word),
                _ => write!(f, "one of {}", words.join(", ")),
            },
            Self::IntegerOf(values) => {
                let values: Vec<String> = values.iter().map(u32::to_string).collect();
                write!(f, "one of {}", values.join(", "))
            }
            Self::Integer { least, most } => write!(f, "a whole number from {least} to {most}"),
            Self::Number { most } if *most == f64::MAX => f.write_str("a number, 0 or more"),
            Self::Number { most } => write!(f, "a number from 0 to {most}"),
            Self::PositiveNumber => f.write_str("a number above 0"),
            Self::Boolean => f.write_str("true or false"),
            Self::Continuation => f.write_str("the `tail` that came with an earlier dance"),
        }
    }
}
