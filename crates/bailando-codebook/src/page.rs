//! One page of HTML with all sheets, which needs no other file.

use crate::{catalogue::Catalogue, error::CodebookError, half::Half, sheet::Order};

const STYLE: &str = "body{font:16px/1.5 sans-serif;color:#343a46;margin:2rem;max-width:1900px}\
svg{width:100%;height:auto}figure{margin:0 0 2rem}";

impl Catalogue {
    /// Writes `index.html`: the sheets of both halves and of the changes between them.
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
        let mut page = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <title>Codebook of {model}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n\
             <h1>Codebook of {model}</h1>\n<p>{} upper and {} lower codes. A repeated code is a \
             still pose; one pair of codes after another is a movement. Left limbs are blue, right \
             ones orange.</p>\n",
            self.upper.codes.len(),
            self.lower.codes.len()
        );
        for (title, svg) in &sheets {
            page += &format!("<h2>{title}</h2>\n<figure>{svg}</figure>\n");
        }
        page += "</body>\n</html>\n";
        Ok(page)
    }
}

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;");
    text.replace('<', "&lt;").replace('>', "&gt;")
}
