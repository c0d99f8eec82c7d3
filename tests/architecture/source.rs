//! References between the files of one crate, read from their text.
//!
//! No type is inferred: a reference is a path in the code whose first names lead to a module of the
//! same crate. Re-exports are followed to the file that defines the item.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use crate::graph::Edges;

type Names = Vec<String>;

/// Splits Rust source into names, `::` and single characters, without comments and literals.
pub(crate) fn tokens(text: &str) -> Names {
    let bytes = text.as_bytes();
    let mut tokens = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let rest = &text[at..];
        let length = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if let Some(length) = string(rest) {
            tokens.push("\"".to_owned());
            length
        } else if rest.starts_with(|first: char| first.is_alphanumeric() || first == '_') {
            let is_name = |c: char| c.is_alphanumeric() || c == '_';
            let length = rest.find(|c| !is_name(c)).unwrap_or(rest.len());
            tokens.push(rest[..length].to_owned());
            length
        } else if rest.starts_with("::") {
            tokens.push("::".to_owned());
            2
        } else {
            let first = rest.chars().next().unwrap();
            if !first.is_whitespace() {
                tokens.push(first.to_string());
            }
            first.len_utf8()
        };
        at += length;
    }
    tokens
}

/// Length of the string or character literal at the start of `rest`, if there is one.
fn string(rest: &str) -> Option<usize> {
    let prefix = rest.find(|c: char| c != 'b' && c != 'r' && c != 'c').unwrap_or(0);
    let body = &rest[prefix..];
    let hashes = body.len() - body.trim_start_matches('#').len();
    if prefix > 0 && rest[..prefix].contains('r') && body[hashes..].starts_with('"') {
        let close = format!("\"{}", "#".repeat(hashes));
        let end = body[hashes + 1..].find(&close)?;
        return Some(prefix + hashes + 1 + end + close.len());
    }
    let quote = body.chars().next().filter(|c| *c == '"' || (*c == '\'' && prefix < 2))?;
    let characters = body.char_indices().skip(1);
    let mut escaped = false;
    for (at, c) in characters {
        if quote == '\'' && !escaped && c != '\\' && at == 1 {
            // A lifetime has no closing quote after its first character.
            let second = body[1 + c.len_utf8()..].chars().next();
            return (second == Some('\'')).then(|| prefix + 2 + c.len_utf8());
        }
        if escaped {
            escaped = false;
        } else if c == '\\' {
            escaped = true;
        } else if c == quote {
            return Some(prefix + at + 1);
        }
    }
    None
}

/// A name that a `use` declaration brings into a file.
struct Import {
    path: Names,
    is_public: bool,
}

/// One file: a module of its crate.
#[derive(Default)]
struct Module {
    file: String,
    definitions: BTreeSet<String>,
    imports: BTreeMap<String, Import>,
    globs: Vec<Names>,
    /// Paths in the code, outside of `use` declarations.
    paths: Vec<Names>,
    /// Children that only tests compile.
    test_modules: Names,
}

/// The modules of a crate by their paths; the crate's root is the empty path.
pub(crate) struct Crate {
    modules: BTreeMap<Names, Module>,
}

impl Crate {
    /// Reads the files of a crate: their paths below its `src`, their names in messages, their
    /// texts.
    pub(crate) fn parse(files: impl IntoIterator<Item = (PathBuf, String, String)>) -> Self {
        let parse = |(path, file, text): (PathBuf, String, String)| {
            let name = module_path(&path);
            let module = Module::parse(file, &name, &without_tests(&tokens(&text)));
            (name, module)
        };
        Self { modules: files.into_iter().map(parse).collect() }
    }

    /// Returns the references from file to file.
    pub(crate) fn edges(&self) -> Edges {
        let mut edges = Edges::new();
        for (name, module) in &self.modules {
            if self.is_for_tests(name) {
                continue;
            }
            let imported = module.imports.values().filter(|import| !import.is_public);
            let paths = module.paths.iter().chain(imported.map(|import| &import.path));
            for path in paths {
                let file = self.file(name, path, 0).filter(|file| *file != module.file);
                if let Some(file) = file {
                    let pair = (module.file.clone(), file);
                    edges.entry(pair).or_insert_with(|| path.join("::"));
                }
            }
        }
        edges
    }

    /// Tells whether the module is compiled for tests only: what it uses is no matter of
    /// architecture.
    fn is_for_tests(&self, name: &Names) -> bool {
        (0..name.len()).any(|length| {
            let parent = self.modules.get(&name[..length]);
            parent.is_some_and(|parent| parent.test_modules.contains(&name[length]))
        })
    }

    /// Returns the file that defines the item at `path`, as written in the module `scope`; none for
    /// items of other crates and for modules.
    fn file(&self, scope: &Names, path: &[String], depth: usize) -> Option<String> {
        let module = self.modules.get(scope)?;
        let (first, rest) = path.split_first()?;
        if depth > 16 {
            return None;
        }
        if first == "crate" {
            return self.walk(&Names::new(), rest, depth + 1);
        }
        if let Some(import) = module.imports.get(first) {
            if import.path.first() == Some(first) {
                return None;
            }
            let path: Names = import.path.iter().chain(rest).cloned().collect();
            return self.file(scope, &path, depth + 1);
        }
        let child: Names = scope.iter().chain([first]).cloned().collect();
        if self.modules.contains_key(&child) {
            return self.walk(&child, rest, depth + 1);
        }
        if module.definitions.contains(first) {
            return Some(module.file.clone());
        }
        let through = |glob: &Names| {
            let path: Names = glob.iter().chain(path).cloned().collect();
            let inside = glob.first().is_some_and(|first| first == "crate");
            if inside { self.file(scope, &path, depth + 1) } else { None }
        };
        module.globs.iter().find_map(through)
    }

    /// Follows `path` down from the module `from`.
    fn walk(&self, from: &Names, path: &[String], depth: usize) -> Option<String> {
        match path.split_first()? {
            (first, rest) if first == "self" => self.walk(from, rest, depth),
            _ => self.file(from, path, depth),
        }
    }
}

/// `engine/mod.rs` is `["engine"]`, `lib.rs` and `main.rs` are the root.
fn module_path(file: &Path) -> Names {
    let mut path = PathBuf::from(file);
    path.set_extension("");
    let mut names: Names = path.iter().map(|name| name.to_string_lossy().into_owned()).collect();
    if names.last().is_some_and(|last| last == "mod" || (names.len() == 1 && last == "lib")) {
        names.pop();
    }
    names
}

impl Module {
    fn parse(file: String, name: &Names, tokens: &[String]) -> Self {
        let mut module = Self { file, ..Self::default() };
        // Inline modules that are open, by the depth of their braces.
        let mut inline: Vec<usize> = Vec::new();
        let (mut braces, mut at) = (0, 0);
        while at < tokens.len() {
            let next = |offset: usize| tokens.get(at + offset).map_or("", String::as_str);
            match tokens[at].as_str() {
                "{" => braces += 1,
                "}" => {
                    braces -= 1;
                    inline.retain(|depth| *depth < braces + 1);
                }
                "mod" if is_test_only(&tokens[..at]) => {
                    module.test_modules.push(next(1).to_owned());
                    at += 2;
                }
                "mod" if next(2) == "{" => {
                    inline.push(braces + 1);
                    braces += 1;
                    at += 2;
                }
                "mod" if next(2) == ";" => at += 2,
                "use" if next(1) != "<" => {
                    let is_public = at > 0 && (tokens[at - 1] == "pub" || tokens[at - 1] == ")");
                    let end = tokens[at..].iter().position(|token| token == ";").unwrap();
                    let mut rest = &tokens[at + 1..at + end];
                    let base = Vec::new();
                    while !rest.is_empty() {
                        rest = module.import(&base, rest, name, inline.len(), is_public);
                    }
                    at += end;
                }
                "struct" | "enum" | "trait" | "fn" | "const" | "static" | "type" | "union" => {
                    module.definitions.insert(next(1).to_owned());
                }
                "macro_rules" => {
                    module.definitions.insert(next(2).to_owned());
                }
                word if is_name(word)
                    && (at == 0 || !["::", "."].contains(&tokens[at - 1].as_str())) =>
                {
                    let mut path = vec![word.to_owned()];
                    while next(2 * path.len() - 1) == "::" && is_name(next(2 * path.len())) {
                        path.push(next(2 * path.len()).to_owned());
                    }
                    module.paths.push(absolute(&path, name, inline.len()));
                }
                _ => {}
            }
            at += 1;
        }
        module
    }

    /// Reads one tree of a `use` declaration; returns the tokens after it.
    fn import<'a>(
        &mut self,
        base: &Names,
        tokens: &'a [String],
        name: &Names,
        inline: usize,
        is_public: bool,
    ) -> &'a [String] {
        let mut path = base.clone();
        let mut rest = tokens;
        while let Some((first, after)) = rest.split_first() {
            rest = after;
            match first.as_str() {
                "::" => {}
                "{" => {
                    while rest.first().is_some_and(|token| token != "}") {
                        rest = self.import(&path, rest, name, inline, is_public);
                    }
                    let after = rest.split_first().map_or(rest, |(_, after)| after);
                    return after.strip_prefix(&[",".to_owned()]).unwrap_or(after);
                }
                "*" => self.globs.push(absolute(&path, name, inline)),
                "as" => {
                    let (alias, after) = rest.split_first().unwrap();
                    self.add(alias, &path, name, inline, is_public);
                    return after.strip_prefix(&[",".to_owned()]).unwrap_or(after);
                }
                "," => break,
                "self" if !path.is_empty() => {}
                word => path.push(word.to_owned()),
            }
            if rest.first().is_some_and(|token| token == "}") {
                break;
            }
        }
        if let Some(last) = path.last().cloned().filter(|_| path != *base || tokens[0] == "self") {
            self.add(&last, &path, name, inline, is_public);
        }
        rest
    }

    fn add(&mut self, alias: &str, path: &Names, name: &Names, inline: usize, is_public: bool) {
        let path = absolute(path, name, inline);
        self.imports.entry(alias.to_owned()).or_insert(Import { path, is_public });
    }
}

/// Returns the tokens without the inline modules that only tests compile.
pub(crate) fn without_tests(tokens: &[String]) -> Names {
    let (mut kept, mut at) = (Names::new(), 0);
    while let Some(token) = tokens.get(at) {
        if token == "mod" && is_test_only(&tokens[..at]) && tokens[at + 2] == "{" {
            at += 2 + block(&tokens[at + 2..]);
        } else {
            kept.push(token.clone());
        }
        at += 1;
    }
    kept
}

/// Tells whether `#[cfg(test)]` stands before the next token.
fn is_test_only(before: &[String]) -> bool {
    const ATTRIBUTE: [&str; 7] = ["#", "[", "cfg", "(", "test", ")", "]"];
    let end = before.len() - usize::from(before.last().is_some_and(|last| last == "pub"));
    before[..end].ends_with(&ATTRIBUTE.map(str::to_owned))
}

/// Returns how far the closing brace is from the opening one at the start of `tokens`.
fn block(tokens: &[String]) -> usize {
    let mut depth = 0;
    tokens
        .iter()
        .position(|token| {
            depth += i32::from(token == "{") - i32::from(token == "}");
            depth == 0
        })
        .expect("braces are balanced")
}

fn is_name(token: &str) -> bool {
    token.starts_with(|first: char| first.is_alphabetic() || first == '_')
}

/// Turns leading `self` and `super` of a path in the module `name` (below `inline` modules within
/// its file) into a path from `crate`; other paths stay.
fn absolute(path: &[String], name: &Names, inline: usize) -> Names {
    let supers = path.iter().take_while(|part| *part == "super").count();
    let own = path.first().is_some_and(|first| first == "self");
    if supers == 0 && !own {
        return path.to_vec();
    }
    let kept = name.len() - supers.saturating_sub(inline).min(name.len());
    let start = std::iter::once("crate".to_owned()).chain(name[..kept].iter().cloned());
    start.chain(path[supers + usize::from(own)..].iter().cloned()).collect()
}
