//! One page that shows everything, without any other file.

use std::fmt::Write;

use super::{Catalogue, CodebookError, Half, Order};

const STYLE: &str = "body{font:16px/1.5 sans-serif;color:#343a46;margin:2rem;max-width:1900px}\
svg{width:100%;height:auto}figure{margin:0 0 2rem}";

impl Catalogue {
    /// `index.html`: the sheets of both halves and of the changes between them.
    ///
    /// # Errors
    /// [`CodebookError::Draw`].
    pub fn page(&self, columns: u32, order: Order) -> Result<String, CodebookError> {
        let mut sheets = Vec::new();
        if !self.transitions.is_empty() {
            sheets.push(("Changes", self.transitions_sheet()?));
        }
        for (title, half) in [("Upper codes", Half::Upper), ("Lower codes", Half::Lower)] {
            sheets.push((title, self.sheet(half, columns, order)?));
        }
        let model = escaped(&self.model);
        let mut page = String::new();
        let mut body = || -> std::fmt::Result {
            writeln!(page, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>")?;
            writeln!(
                page,
                "<meta charset=\"utf-8\">\n<title>Codebook of {model}</title>"
            )?;
            writeln!(page, "<style>{STYLE}</style>\n</head>\n<body>")?;
            writeln!(page, "<h1>Codebook of {model}</h1>")?;
            writeln!(
                page,
                "<p>{} upper and {} lower codes. A code that is repeated is a still pose; one pair \
                 of codes after another is a movement. Left limbs are blue, right ones orange.</p>",
                self.upper.codes.len(),
                self.lower.codes.len()
            )?;
            for (title, svg) in &sheets {
                writeln!(page, "<h2>{title}</h2>\n<figure>{svg}</figure>")?;
            }
            writeln!(page, "</body>\n</html>")
        };
        body().map_err(|error| CodebookError::Draw(error.to_string()))?;
        Ok(page)
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
