//! A dance as local rotations on the bones of a file.

use std::collections::BTreeMap;

use bailando_motion::{BodyPart, Figure, FigureBone, Retargeted, Side};
use glam::{DQuat, DVec3};

use super::{parts::Parts, refusal::problem, tree::Tree};
use crate::error::FormatError;

/// Ends of a foot that are looked at.
const FOOT_ENDS: usize = 64;

/// Rotations of the bones that dance.
#[derive(Clone, Debug)]
pub(super) struct Poses {
    pub(super) fps: u32,
    pub(super) hips_bone: usize,
    /// Where the hips are in the world.
    pub(super) hips: Vec<DVec3>,
    /// Bones that turn.
    pub(super) bones: Vec<usize>,
    /// Whether they are hips or of a leg.
    pub(super) carries_feet: Vec<bool>,
    /// Their local rotations, `[bone][frame]`, whose signs are continuous.
    pub(super) turns: Vec<Vec<DQuat>>,
}

/// Returns the parts of the body with their bones, in the order of the figure's bones.
pub(super) fn ordered(parts: &Parts) -> Vec<(BodyPart, usize)> {
    let each = parts.iter().flat_map(|(&part, bones)| bones.iter().map(move |&bone| (part, bone)));
    each.collect()
}

/// Returns the figure that the mapped bones are.
pub(super) fn figure(tree: &Tree, parts: &Parts, stands_on_origin: bool) -> Figure {
    let bones = ordered(parts).into_iter();
    let bones = bones.map(|(part, bone)| FigureBone { part, place: tree.places[bone] });
    let feet = Side::BOTH.map(|side| {
        let foot = parts.get(&BodyPart::Foot(side)).map_or(&[][..], Vec::as_slice);
        let below = foot.iter().flat_map(|&foot| tree.below(foot)).take(FOOT_ENDS);
        below.map(|bone| tree.places[bone]).collect()
    });
    Figure { bones: bones.collect(), feet, stands_on_origin }
}

/// Checks that no bone above a mapped one stretches it unevenly.
pub(super) fn check_scales(tree: &Tree, parts: &Parts) -> Result<(), FormatError> {
    for (_, bone) in ordered(parts) {
        if let Some(parent) = tree.bones[bone].parent
            && tree.scale_below(parent).is_none()
        {
            let (name, parent) = (tree.shown(bone), tree.shown(parent));
            return problem(format!(
                "the scale of `{parent}`, or of a bone above it, is zero or differs between axes, \
                 so that `{name}` cannot turn without shearing: apply the scale first"
            ));
        }
    }
    Ok(())
}

fn carries_feet(part: BodyPart) -> bool {
    let is_leg = |side| {
        [BodyPart::UpperLeg(side), BodyPart::LowerLeg(side), BodyPart::Foot(side)].contains(&part)
    };
    part == BodyPart::Hips || Side::BOTH.into_iter().any(is_leg)
}

impl Poses {
    /// Makes world rotations from rest local ones.
    pub(super) fn new(tree: &Tree, parts: &Parts, dance: Retargeted) -> Self {
        let ordered = ordered(parts);
        let figure_bone: BTreeMap<usize, usize> =
            ordered.iter().enumerate().map(|(index, &(_, bone))| (bone, index)).collect();
        let hips_bone = parts.get(&BodyPart::Hips).map_or(0, |bones| bones[0]);
        let bones: Vec<usize> = figure_bone.keys().copied().collect();
        let tracks = bones.iter().map(|&bone| {
            let own = figure_bone[&bone];
            let above = tree.above(bone).find_map(|above| figure_bone.get(&above).copied());
            let parent = tree.bones[bone].parent;
            let parent_rest = parent.map_or(DQuat::IDENTITY, |parent| tree.turns[parent]);
            let rest = tree.turns[bone];
            let mut last = DQuat::IDENTITY;
            let local = dance.turns.iter().map(|turns| {
                let around = above.map_or(DQuat::IDENTITY, |above| turns[above]) * parent_rest;
                let turn = (around.inverse() * turns[own] * rest).normalize();
                last = if turn.dot(last) < 0.0 { -turn } else { turn };
                last
            });
            local.collect()
        });
        let turns = tracks.collect();
        let carries_feet = bones.iter().map(|bone| carries_feet(ordered[figure_bone[bone]].0));
        let carries_feet = carries_feet.collect();
        Self { fps: dance.fps, hips_bone, hips: dance.hips, bones, carries_feet, turns }
    }

    /// Returns which of the tracks is that of a bone.
    pub(super) fn track_of(&self, bone: usize) -> Option<usize> {
        self.bones.binary_search(&bone).ok()
    }

    /// Returns the hips' places in the axes of the bone above them, which rests.
    pub(super) fn local_hips(&self, tree: &Tree) -> Vec<DVec3> {
        let (place, turn, scale) = match tree.bones[self.hips_bone].parent {
            None => (DVec3::ZERO, DQuat::IDENTITY, 1.0),
            Some(parent) => {
                let scale = tree.scale_below(parent).unwrap_or(1.0);
                (tree.places[parent], tree.turns[parent], scale)
            }
        };
        self.hips.iter().map(|&hips| turn.inverse() * (hips - place) / scale).collect()
    }
}
