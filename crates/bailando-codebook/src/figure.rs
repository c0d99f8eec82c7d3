//! A stick figure of a pose.

use std::fmt::Display;

use glam::{Quat, Vec3};
use plotters::{
    coord::Shift,
    drawing::DrawingArea,
    element::{Circle, PathElement},
    prelude::SVGBackend,
    style::{Color, RGBColor},
};

use super::{Catalogue, CodebookError, Half};
use bailando_motion::Skeleton;

/// A part of a sheet, in pixels.
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Pixels per metre.
const SCALE: f32 = 84.0;
/// The viewer stands a little to the figure's left: legs that cross are told apart.
const ASIDE: f32 = 0.35;
const WIDTH: u32 = 5;
/// Radius of a head, metres.
const HEAD: f32 = 0.11;

const TRUNK: RGBColor = RGBColor(52, 58, 70);
const LEFT: RGBColor = RGBColor(38, 132, 186);
const RIGHT: RGBColor = RGBColor(224, 106, 59);
const PALE: RGBColor = RGBColor(208, 208, 204);
pub(super) const FLOOR: RGBColor = RGBColor(226, 224, 218);

/// Bones that are drawn in one stroke.
struct Limb {
    joints: Vec<usize>,
    half: Half,
    colour: RGBColor,
}

/// How to draw poses of one skeleton.
pub(super) struct Figure {
    limbs: Vec<Limb>,
    /// The head, and what it sits on.
    head: Option<[usize; 2]>,
}

/// Where and how a pose is drawn.
pub(super) struct Stand {
    /// The floor below the root, pixels.
    pub(super) floor: (i32, i32),
    /// Half that is drawn strong; none: the whole body is.
    pub(super) strong: Option<Half>,
}

impl Figure {
    pub(super) fn new(catalogue: &Catalogue) -> Self {
        let skeleton = &catalogue.skeleton;
        let upper = &catalogue.upper.joints;
        let half = |joint: usize| match upper.contains(&joint) {
            true => Half::Upper,
            false => Half::Lower,
        };
        let alike = |a: usize, b: usize| {
            half(a) == half(b) && side_colour(skeleton, a) == side_colour(skeleton, b)
        };
        let joints = 0..skeleton.joints.len();
        let next = |joint: usize| {
            let mut children = joints
                .clone()
                .filter(|&c| skeleton.parent(c) == Some(joint));
            children.find(|&child| joint != 0 && alike(child, joint))
        };
        let limbs = joints.clone().filter_map(|first| {
            let parent = skeleton.parent(first)?;
            if next(parent) == Some(first) {
                return None;
            }
            let rest = std::iter::successors(Some(first), |&joint| next(joint));
            Some(Limb {
                joints: std::iter::once(parent).chain(rest).collect(),
                half: half(first),
                colour: side_colour(skeleton, first),
            })
        });
        let head = skeleton.joints.iter().position(|name| name == "head");
        Self {
            limbs: limbs.collect(),
            head: head.and_then(|head| Some([head, skeleton.parent(head)?])),
        }
    }

    /// Draws `pose` with its lowest joint on the floor.
    pub(super) fn draw(
        &self,
        area: &Area<'_>,
        pose: &[Vec3],
        stand: &Stand,
    ) -> Result<(), CodebookError> {
        let lowest = pose
            .iter()
            .map(|joint| joint.y)
            .fold(f32::INFINITY, f32::min);
        let (x, y) = stand.floor;
        let seen = |joint: Vec3| {
            let (right, up) = (joint.x * SCALE, (joint.y - lowest) * SCALE);
            (x + right.round() as i32, y - up.round() as i32)
        };
        let at = |joint: &usize| pose.get(*joint).copied().unwrap_or_default();
        let weak = |half| stand.strong.is_some_and(|strong| strong != half);
        let depth = |limb: &Limb| {
            let sum: f32 = limb.joints.iter().map(|joint| at(joint).z).sum();
            sum / limb.joints.len().max(1) as f32
        };
        let mut limbs: Vec<&Limb> = self.limbs.iter().collect();
        // What is pale is behind, then what is farther from the viewer at +z.
        limbs.sort_by(|a, b| {
            let pale = weak(b.half).cmp(&weak(a.half));
            pale.then(depth(a).total_cmp(&depth(b)))
        });
        for limb in limbs {
            let colour = if weak(limb.half) { PALE } else { limb.colour };
            let points: Vec<(i32, i32)> = limb.joints.iter().map(|joint| seen(at(joint))).collect();
            let stroke = PathElement::new(points, colour.stroke_width(WIDTH));
            area.draw(&stroke).map_err(drawn)?;
        }
        if let Some([head, neck]) = self.head {
            let up = (at(&head) - at(&neck)).normalize_or_zero();
            let middle = seen(at(&head) + 0.5 * HEAD * up);
            let colour = if weak(Half::Upper) { PALE } else { TRUNK };
            let round = Circle::new(middle, (HEAD * SCALE) as i32, colour.filled());
            area.draw(&round).map_err(drawn)?;
        }
        Ok(())
    }
}

/// Turns a pose that faces +z to the viewer.
pub(super) fn to_viewer(pose: &[[f32; 3]]) -> Vec<Vec3> {
    let turn = Quat::from_rotation_y(-ASIDE);
    pose.iter().map(|&place| turn * Vec3::from(place)).collect()
}

fn side_colour(skeleton: &Skeleton, joint: usize) -> RGBColor {
    let name = skeleton.joints.get(joint).map_or("", String::as_str);
    match name.get(..2) {
        Some("l_") => LEFT,
        Some("r_") => RIGHT,
        _ => TRUNK,
    }
}

pub(super) fn drawn(error: impl Display) -> CodebookError {
    CodebookError::Draw(error.to_string())
}
