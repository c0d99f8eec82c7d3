//! What an option accepts: checked, described, and written as a schema.

use std::fmt;

use utoipa::openapi::schema::{Object, ObjectBuilder, Type};

use crate::formats::{Codes, Continuation};

/// Longest value of most options that is read, in bytes.
pub(super) const LONGEST_VALUE: usize = 1024;
/// Longest value of `codes` that is read, in bytes: those of a dance of three hours.
pub(super) const LONGEST_CODES: usize = 1 << 20;

/// What an option accepts.
#[derive(Clone, Copy)]
pub(crate) enum Accepts {
    Words(&'static [&'static str]),
    IntegerOf(&'static [u32]),
    /// From the least to the most.
    Integer(u64, u64),
    /// From 0 to the most.
    Number(f64),
    /// Above 0.
    PositiveNumber,
    Boolean,
    /// The end of an earlier result.
    Tail,
    /// A name whose model says whether it knows it.
    Style,
    /// Pose codes.
    Codes,
}

impl Accepts {
    pub(super) fn admits(self, text: &str) -> bool {
        let number = || text.parse::<f64>().ok().filter(|value| value.is_finite());
        match self {
            Self::Words(words) => words.contains(&text),
            Self::IntegerOf(values) => text.parse().is_ok_and(|value| values.contains(&value)),
            Self::Integer(least, most) => {
                text.parse::<u64>().is_ok_and(|value| (least..=most).contains(&value))
            }
            Self::Number(most) => number().is_some_and(|value| (0.0..=most).contains(&value)),
            Self::PositiveNumber => number().is_some_and(|value| value > 0.0),
            Self::Boolean => boolean(text).is_some(),
            Self::Tail => text.parse::<Continuation>().is_ok(),
            Self::Style => !text.is_empty(),
            Self::Codes => text.parse::<Codes>().is_ok(),
        }
    }

    /// Most bytes of a value that is read.
    pub(crate) const fn longest(self) -> usize {
        match self {
            Self::Codes => LONGEST_CODES,
            _ => LONGEST_VALUE,
        }
    }

    /// The words that are all that is accepted, if they are.
    pub(super) fn words(self) -> Option<&'static [&'static str]> {
        match self {
            Self::Words(words) => Some(words),
            Self::Boolean => Some(&["true", "false"]),
            _ => None,
        }
    }

    pub(crate) fn schema(self) -> Object {
        let of = |kind: Type| ObjectBuilder::new().schema_type(kind);
        match self {
            Self::Words(words) => of(Type::String).enum_values(Some(words.iter().copied())),
            Self::IntegerOf(values) => of(Type::Integer).enum_values(Some(values.iter().copied())),
            Self::Integer(least, most) => {
                of(Type::Integer).minimum(Some(least)).maximum(Some(most))
            }
            Self::Number(most) => of(Type::Number).minimum(Some(0)).maximum(Some(most)),
            Self::PositiveNumber => of(Type::Number).exclusive_minimum(Some(0)),
            Self::Boolean => of(Type::Boolean),
            Self::Tail => of(Type::String).pattern(Some("^[A-Za-z0-9_-]{31,1024}$")),
            Self::Style => of(Type::String).pattern(Some("^[a-z0-9-]{1,32}$")),
            Self::Codes => of(Type::String).max_length(Some(LONGEST_CODES)),
        }
        .build()
    }
}

/// Reads `true` or `false`, and `True` or `False` as Python's clients write them.
pub(super) fn boolean(text: &str) -> Option<bool> {
    match text {
        "true" | "True" => Some(true),
        "false" | "False" => Some(false),
        _ => None,
    }
}

impl fmt::Display for Accepts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Words([word]) => f.write_str(word),
            Self::Words(words) => write!(f, "one of {}", words.join(", ")),
            Self::IntegerOf(values) => {
                let values: Vec<String> = values.iter().map(u32::to_string).collect();
                write!(f, "one of {}", values.join(", "))
            }
            Self::Integer(least, most) => write!(f, "a whole number from {least} to {most}"),
            Self::Number(most) => write!(f, "a number from 0 to {most}"),
            Self::PositiveNumber => f.write_str("a number above 0"),
            Self::Boolean => f.write_str("true or false"),
            Self::Tail => f.write_str("the `tail` that came with an earlier dance"),
            Self::Style => f.write_str("auto, or a style of the model"),
            Self::Codes => f.write_str(Codes::WRITTEN),
        }
    }
}
