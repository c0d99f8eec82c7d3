//! The bones of a file: names, hierarchy and rest pose.

use std::collections::HashMap;

use glam::{DQuat, DVec3};

use super::refusal::{problem, short};
use crate::error::FormatError;

/// Scales of the axes of a bone are equal when they are as near as this.
const EVEN: f64 = 0.01;

/// A bone before the hierarchy is known to be one.
#[derive(Clone, Debug)]
pub(super) struct Bone {
    pub(super) name: String,
    pub(super) parent: Option<usize>,
    /// In the parent's axes.
    pub(super) place: DVec3,
    pub(super) turn: DQuat,
    pub(super) scale: DVec3,
    /// Whether it may turn: ends of bones, and nodes that move no skin, do not.
    pub(super) turns: bool,
}

/// Bones of a file in their order, and their rest pose in the world.
#[derive(Clone, Debug)]
pub(super) struct Tree {
    pub(super) bones: Vec<Bone>,
    pub(super) children: Vec<Vec<usize>>,
    /// Every bone after its parent.
    pub(super) order: Vec<usize>,
    pub(super) places: Vec<DVec3>,
    pub(super) turns: Vec<DQuat>,
    scales: Vec<f64>,
    /// Whether scales stretch a bone's children unevenly.
    uneven: Vec<bool>,
    /// Whether a bone's name is that of no other.
    is_named: Vec<bool>,
}

impl Tree {
    /// Orders bones, whose parents are bones.
    pub(super) fn new(bones: Vec<Bone>) -> Result<Self, FormatError> {
        let count = bones.len();
        let mut children = vec![Vec::new(); count];
        let mut order = Vec::with_capacity(count);
        for (index, bone) in bones.iter().enumerate() {
            match bone.parent {
                Some(parent) => children[parent].push(index),
                None => order.push(index),
            }
        }
        let mut next = 0;
        while let Some(&index) = order.get(next) {
            order.extend(&children[index]);
            next += 1;
        }
        if order.len() < count {
            return problem("its bones hang on each other in a circle");
        }
        let mut tree = Self {
            places: vec![DVec3::ZERO; count],
            turns: vec![DQuat::IDENTITY; count],
            scales: vec![1.0; count],
            uneven: vec![false; count],
            is_named: own_names(&bones),
            bones,
            children,
            order,
        };
        tree.rest()?;
        Ok(tree)
    }

    fn rest(&mut self) -> Result<(), FormatError> {
        for &index in &self.order {
            let bone = &self.bones[index];
            let (place, turn, scale, uneven) = match bone.parent {
                None => (DVec3::ZERO, DQuat::IDENTITY, 1.0, false),
                Some(at) => (self.places[at], self.turns[at], self.scales[at], self.uneven[at]),
            };
            let place = place + turn * (bone.place * scale);
            let turn = turn * bone.turn;
            if !place.is_finite() || !turn.is_finite() || turn.length() < 0.5 {
                let name = self.shown(index);
                return problem(format!("`{name}` rests nowhere (NaN, infinity or a zero turn)"));
            }
            let own = bone.scale;
            self.places[index] = place;
            self.turns[index] = turn.normalize();
            self.scales[index] = scale * own.x;
            let spread = (own - DVec3::splat(own.x)).abs().max_element();
            let even = spread <= EVEN * own.x.abs();
            self.uneven[index] = uneven || !even;
        }
        Ok(())
    }

    /// Returns the scale of what hangs on a bone; none where it differs between axes.
    pub(super) fn scale_below(&self, bone: usize) -> Option<f64> {
        let scale = self.scales[bone];
        (!self.uneven[bone] && scale.is_finite() && scale.abs() > 1e-12).then_some(scale)
    }

    /// Returns bones from a bone's parent up to the root.
    pub(super) fn above(&self, bone: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(self.bones[bone].parent, move |&bone| self.bones[bone].parent)
    }

    pub(super) fn is_above(&self, above: usize, below: usize) -> bool {
        self.above(below).any(|bone| bone == above)
    }

    /// Returns the lowest bone that all of these are, or hang on.
    pub(super) fn common(&self, bones: &[usize]) -> Option<usize> {
        let (first, others) = bones.split_first()?;
        let mut candidates = std::iter::once(*first).chain(self.above(*first));
        candidates
            .find(|&bone| others.iter().all(|&other| other == bone || self.is_above(bone, other)))
    }

    /// Returns the bones between two of which one is above the other, from above.
    pub(super) fn between(&self, above: usize, below: usize) -> Vec<usize> {
        let mut path: Vec<usize> = self.above(below).take_while(|&bone| bone != above).collect();
        path.reverse();
        path
    }

    /// Returns everything that hangs on a bone.
    pub(super) fn below(&self, bone: usize) -> Vec<usize> {
        let mut all = self.children[bone].clone();
        let mut next = 0;
        while let Some(&bone) = all.get(next) {
            all.extend(&self.children[bone]);
            next += 1;
        }
        all
    }

    /// Returns the distance from a bone to the farthest below it.
    pub(super) fn reach(&self, bone: usize) -> f64 {
        let from = self.places[bone];
        let below = self.below(bone).into_iter();
        below.map(|other| self.places[other].distance(from)).fold(0.0, f64::max)
    }

    /// Returns the name by which a mapping knows a bone: its own, or its number in the file where
    /// that is no name of its own.
    pub(super) fn label(&self, bone: usize) -> String {
        match self.is_named[bone] {
            true => self.bones[bone].name.clone(),
            false => format!("#{bone}"),
        }
    }

    /// Returns a bone's label as errors show it.
    pub(super) fn shown(&self, bone: usize) -> String {
        short(&self.label(bone))
    }

    /// Finds a bone by its label.
    pub(super) fn labelled(&self, label: &str) -> Result<usize, FormatError> {
        let named = || self.bones.iter().enumerate().filter(|(_, bone)| bone.name == label);
        let number = label.strip_prefix('#').and_then(|number| number.parse::<usize>().ok());
        match (named().next(), named().count(), number) {
            (Some((bone, _)), 1, _) => Ok(bone),
            (None, _, Some(bone)) if bone < self.bones.len() => Ok(bone),
            (None, ..) => {
                problem(format!("the mapping names `{}`, which it does not have", short(label)))
            }
            (Some((bone, _)), count, _) => problem(format!(
                "the mapping names `{}`, and {count} bones are called so: write `#{bone}` for the \
                 first",
                short(label)
            )),
        }
    }
}

/// Whether each bone has a name that no other has. Counted once: a caller's rig may have thousands
/// of long names that hardly differ.
fn own_names(bones: &[Bone]) -> Vec<bool> {
    let mut counts: HashMap<&str, usize> = HashMap::new();
    for bone in bones {
        *counts.entry(&bone.name).or_default() += 1;
    }
    bones.iter().map(|bone| !bone.name.is_empty() && counts[bone.name.as_str()] == 1).collect()
}
