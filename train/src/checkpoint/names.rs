//! Names of tensors and files: what wrappers and tools make of them.

use std::{collections::BTreeMap, path::Path};

use super::{
    error::Problem,
    pickle::{Arena, Id, Object, Pickled, TensorView},
};

/// What distributed training, and `torch.compile`, put in front of a module's names.
const WRAPPERS: [&str; 2] = ["module", "_orig_mod"];

/// Tensors by their plain names.
pub(super) type Views = BTreeMap<String, TensorView>;

/// Collects the tensors of `{'model': state_dict, ..}`, or of a bare state dictionary.
pub(super) fn of_pickle(pickled: &Pickled) -> Result<Views, Problem> {
    let arena = &pickled.arena;
    let state = arena.lookup(pickled.root, "model").unwrap_or(pickled.root);
    let entries = arena.entries(state).ok_or(Problem::NoTensors)?;
    let views = entries.iter().filter_map(|&(key, value)| named_view(arena, key, value));
    plain(views.map(|(name, view)| (name, view.clone())))
}

fn named_view(arena: &Arena, key: Id, value: Id) -> Option<(&str, &TensorView)> {
    match arena.get(value)? {
        Object::Tensor(view) => Some((arena.text(key)?, view)),
        _ => None,
    }
}

/// Takes what wrappers add out of the names, which must stay apart.
pub(super) fn plain<'a>(
    views: impl Iterator<Item = (&'a str, TensorView)>,
) -> Result<Views, Problem> {
    let mut plain = BTreeMap::new();
    for (name, view) in views {
        let name = plain_name(name);
        if plain.contains_key(&name) {
            return Err(Problem::Duplicate(name));
        }
        plain.insert(name, view);
    }
    if plain.is_empty() {
        return Err(Problem::NoTensors);
    }
    Ok(plain)
}

/// A module that is a part of another may be compiled alone; `module.` means something in front
/// only.
fn plain_name(name: &str) -> String {
    let mut parts = name.split('.').peekable();
    while parts.next_if(|part| WRAPPERS.contains(part)).is_some() {}
    let parts: Vec<&str> = parts.filter(|&part| part != "_orig_mod").collect();
    parts.join(".")
}

/// Whether the file is named as one of several, `model-00001-of-00003.safetensors`.
pub(super) fn is_shard(path: &Path) -> bool {
    let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    let number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    stem.rsplit_once("-of-").is_some_and(|(front, count)| {
        number(count) && front.rsplit_once('-').is_some_and(|(_, place)| number(place))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrappers_vanish_from_names() {
        for (name, expected) in [
            ("gpt_base.ln.weight", "gpt_base.ln.weight"),
            ("module.gpt_base.ln.weight", "gpt_base.ln.weight"),
            ("_orig_mod.gpt_base.ln.weight", "gpt_base.ln.weight"),
            ("module._orig_mod.gpt_base.ln.weight", "gpt_base.ln.weight"),
            ("_orig_mod.module.gpt_base.ln.weight", "gpt_base.ln.weight"),
            ("gpt_base._orig_mod.ln.weight", "gpt_base.ln.weight"),
            ("gpt_base.module.weight", "gpt_base.module.weight"),
        ] {
            assert_eq!(plain_name(name), expected);
        }
    }

    #[test]
    fn shards_are_told_by_their_names() {
        assert!(is_shard(Path::new("a/model-00001-of-00003.safetensors")));
        assert!(is_shard(Path::new("pytorch_model-2-of-2.bin")));
        for whole in ["model.safetensors", "best-of-3.pt", "out-of-3.pt", "a-1-of-b.pt"] {
            assert!(!is_shard(Path::new(whole)), "{whole}");
        }
    }
}
