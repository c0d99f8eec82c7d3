//! Changes of a JSON text in a few places, which leave every other byte as it is.

use std::{fmt, marker::PhantomData};

use serde::{
    Deserialize,
    de::{DeserializeSeed, Deserializer as _, Error, SeqAccess, Visitor},
};
use serde_json::value::RawValue;

use super::refusal::problem;
use crate::error::FormatError;

/// A text and the changes of it.
pub(super) struct Splice<'a> {
    text: &'a str,
    /// First byte, bytes that go, and what comes instead.
    edits: Vec<(usize, usize, String)>,
}

impl<'a> Splice<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        Self { text, edits: Vec::new() }
    }

    /// Where a part of the text begins.
    fn place(&self, part: &str) -> usize {
        let place = (part.as_ptr() as usize).wrapping_sub(self.text.as_ptr() as usize);
        debug_assert!(self.text.get(place..place + part.len()) == Some(part));
        place
    }

    /// Puts other text in the place of a value.
    pub(super) fn replace(&mut self, value: &RawValue, text: String) {
        self.edits.push((self.place(value.get()), value.get().len(), text));
    }

    /// Puts other members in the place of a value and its key.
    pub(super) fn replace_member(
        &mut self,
        key: &str,
        value: &RawValue,
        text: String,
    ) -> Result<(), FormatError> {
        let place = self.place(value.get());
        let quoted = format!("\"{key}\"");
        let before = self.text.get(..place).unwrap_or_default();
        let found = before.rfind(&quoted).filter(|&at| {
            let between = &before[at + quoted.len()..];
            between.trim() == ":"
        });
        let Some(at) = found else {
            return problem(format!("a `{key}` of its JSON is written in an unusual way"));
        };
        self.edits.push((at, place + value.get().len() - at, text));
        Ok(())
    }

    /// Adds elements to an array of the top level, which may not be there yet.
    pub(super) fn append(
        &mut self,
        key: &str,
        array: Option<&RawValue>,
        elements: &[String],
    ) -> Result<(), FormatError> {
        let elements = elements.join(",");
        let Some(array) = array else {
            let end = self.text.trim_end().len().saturating_sub(1);
            // There is an `asset` before it.
            self.edits.push((end, 0, format!(",\"{key}\":[{elements}]")));
            return Ok(());
        };
        let Some(inside) = array.get().strip_prefix('[').and_then(|text| text.strip_suffix(']'))
        else {
            return problem(format!("`{key}` of its JSON is not an array"));
        };
        let comma = if inside.trim().is_empty() { "" } else { "," };
        let end = self.place(array.get()) + array.get().len() - 1;
        self.edits.push((end, 0, format!("{comma}{elements}")));
        Ok(())
    }

    /// Returns the changed text.
    pub(super) fn finish(mut self) -> String {
        // Those of one place stay in their order.
        self.edits.sort_by_key(|&(at, ..)| at);
        let added: usize = self.edits.iter().map(|(_, _, text)| text.len()).sum();
        let mut text = String::with_capacity(self.text.len() + added);
        let mut done = 0;
        for (at, gone, new) in self.edits {
            text.push_str(&self.text[done..at]);
            text.push_str(&new);
            done = at + gone;
        }
        text.push_str(&self.text[done..]);
        text
    }
}

/// Reads an array of at most so many elements.
pub(super) fn array<'a, T: Deserialize<'a>>(
    name: &str,
    text: Option<&'a RawValue>,
    most: usize,
) -> Result<Vec<T>, FormatError> {
    struct AtMost<T>(usize, PhantomData<T>);

    impl<'a, T: Deserialize<'a>> Visitor<'a> for AtMost<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "an array of at most {} elements", self.0)
        }

        fn visit_seq<A: SeqAccess<'a>>(self, mut elements: A) -> Result<Vec<T>, A::Error> {
            let mut all = Vec::new();
            while let Some(element) = elements.next_element()? {
                if all.len() == self.0 {
                    return Err(A::Error::custom(format!("more than {} elements", self.0)));
                }
                all.push(element);
            }
            Ok(all)
        }
    }

    impl<'a, T: Deserialize<'a>> DeserializeSeed<'a> for AtMost<T> {
        type Value = Vec<T>;

        fn deserialize<D: serde::Deserializer<'a>>(self, from: D) -> Result<Vec<T>, D::Error> {
            from.deserialize_seq(self)
        }
    }

    let Some(text) = text else { return Ok(Vec::new()) };
    let mut json = serde_json::Deserializer::from_str(text.get());
    let read = AtMost(most, PhantomData).deserialize(&mut json);
    read.or_else(|error| {
        let error: String = error.to_string().chars().take(120).collect();
        problem(format!("`{name}` of its JSON: {error}"))
    })
}

/// Returns the number of elements of an array.
pub(super) fn count(name: &str, text: Option<&RawValue>) -> Result<usize, FormatError> {
    struct Count;

    impl<'a> Visitor<'a> for Count {
        type Value = usize;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("an array")
        }

        fn visit_seq<A: SeqAccess<'a>>(self, mut elements: A) -> Result<usize, A::Error> {
            let mut count = 0;
            while elements.next_element::<serde::de::IgnoredAny>()?.is_some() {
                count += 1;
            }
            Ok(count)
        }
    }

    let Some(text) = text else { return Ok(0) };
    let mut json = serde_json::Deserializer::from_str(text.get());
    let counted = json.deserialize_seq(Count);
    counted.or_else(|error| problem(format!("`{name}` of its JSON: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct Root<'a> {
        #[serde(borrow)]
        a: &'a RawValue,
        #[serde(borrow)]
        b: Option<&'a RawValue>,
    }

    #[test]
    fn everything_else_stays_byte_for_byte() {
        let text = "{ \"a\" : [ 1.10 , 2e-0 ],\t\"x\":{\"m\" :[1],\"y\":1.0000000000000001} } ";
        let root: Root<'_> = serde_json::from_str(text).unwrap();
        let mut splice = Splice::new(text);
        splice.append("a", Some(root.a), &["3".into(), "4".into()]).unwrap();
        splice.append("b", root.b, &["5".into()]).unwrap();
        assert_eq!(
            splice.finish(),
            "{ \"a\" : [ 1.10 , 2e-0 ,3,4],\t\"x\":{\"m\" :[1],\"y\":1.0000000000000001} \
             ,\"b\":[5]} "
        );
        let mut splice = Splice::new(text);
        splice.replace_member("a", root.a, "\"c\":0".into()).unwrap();
        assert!(splice.finish().starts_with("{ \"c\":0,\t\"x\""));
        assert_eq!(count("a", Some(root.a)).unwrap(), 2);
        assert!(array::<f64>("a", Some(root.a), 1).is_err());
    }
}
