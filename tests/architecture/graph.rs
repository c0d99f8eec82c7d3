//! Circles of a directed graph.

use std::collections::{BTreeMap, BTreeSet};

/// References between files: (from, to) and one name that is referred to.
pub(crate) type Edges = BTreeMap<(String, String), String>;

/// Files that reach each other, with the references among them.
pub(crate) struct Circle {
    pub(crate) files: BTreeSet<String>,
    pub(crate) edges: Vec<(String, String, String)>,
}

/// Returns the strongly connected parts of more than one file.
pub(crate) fn circles(edges: &Edges) -> Vec<Circle> {
    let files: BTreeSet<&String> = edges.keys().flat_map(|(from, to)| [from, to]).collect();
    let reached: BTreeMap<_, _> = files.iter().map(|file| (*file, reach(edges, file))).collect();
    let mut circles = Vec::new();
    let mut placed = BTreeSet::new();
    for file in files {
        if !reached[file].contains(file) || placed.contains(file) {
            continue;
        }
        let members: BTreeSet<String> =
            reached[file].iter().filter(|other| reached[*other].contains(file)).cloned().collect();
        let inside = |(from, to): &(String, String)| members.contains(from) && members.contains(to);
        let edges = edges.iter().filter(|(pair, _)| inside(pair));
        let edges = edges.map(|((from, to), name)| (from.clone(), to.clone(), name.clone()));
        placed.extend(members.iter().cloned());
        circles.push(Circle { edges: edges.collect(), files: members });
    }
    circles
}

/// Returns the files that `start` leads to in one step or more.
fn reach(edges: &Edges, start: &str) -> BTreeSet<String> {
    let mut reached = BTreeSet::new();
    let mut waiting = vec![start.to_owned()];
    while let Some(file) = waiting.pop() {
        for (from, to) in edges.keys() {
            if *from == file && reached.insert(to.clone()) {
                waiting.push(to.clone());
            }
        }
    }
    reached
}
