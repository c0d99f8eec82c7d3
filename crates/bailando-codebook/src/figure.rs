//! A stick figure of a pose.

use glam::{Quat, Vec3};
use plotters::{
    coord::Shift,
    drawing::DrawingArea,
    element::{Circle, PathElement},
    prelude::SVGBackend,
    style::{Color, RGBColor},
};

use crate::{error::CodebookError, half::Half};
use bailando_motion::Skeleton;

/// A part of a sheet, in pixels.
pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Pixels per metre.
const SCALE: f32 = 84.0;
/// The viewer stands a little to the figure's left, so that crossed legs can be distinguished.
/// Radians.
const ASIDE: f32 = 0.35;
const WIDTH: u32 = 5;
/// Radius of a head, metres.
const HEAD: f32 = 0.11;

const TRUNK: RGBColor = RGBColor(52, 58, 70);
const LEFT: RGBColor = RGBColor(38, 132, 186);
const RIGHT: RGBColor = RGBColor(224, 106, 59);
const PALE: RGBColor = RGBColor(208, 208, 204);
pub(crate) const FLOOR: RGBColor = RGBColor(226, 224, 218);

/// Bones that are drawn in one stroke.
struct Limb {
    joints: Vec<usize>,
    half: Half,
    colour: RGBColor,
}

/// The limbs of one skeleton, as they are drawn.
pub(crate) struct Figure {
    limbs: Vec<Limb>,
    /// The head and its parent.
    head: Option<[usize; 2]>,
}

/// Where and how a pose is drawn.
pub(crate) struct Placement {
    /// The floor below the root, pixels.
    pub(crate) floor: (i32, i32),
    /// Half in strong colours, the other is pale; none: both are strong.
    pub(crate) strong: Option<Half>,
}

impl Figure {
    pub(crate) fn new(skeleton: &Skeleton, upper_joints: &[usize]) -> Self {
        let half = |joint| Half::of_joint(joint, upper_joints);
        let look = |joint| (half(joint), side_colour(skeleton, joint));
        let joints = 0..skeleton.joints.len();
        // The child that continues the stroke of a joint.
        let next = |joint: usize| {
            let mut children =
                joints.clone().filter(|&child| skeleton.parent(child) == Some(joint));
            children.find(|&child| joint != 0 && look(child) == look(joint))
        };
        let limbs = joints.clone().filter_map(|first| {
            let parent = skeleton.parent(first)?;
            if next(parent) == Some(first) {
                return None;
            }
            let rest = std::iter::successors(Some(first), |&joint| next(joint));
            let (half, colour) = look(first);
            Some(Limb { joints: std::iter::once(parent).chain(rest).collect(), half, colour })
        });
        let head = skeleton.joints.iter().position(|name| name == "head");
        Self {
            limbs: limbs.collect(),
            head: head.and_then(|head| Some([head, skeleton.parent(head)?])),
        }
    }

    /// Draws `pose` with its lowest joint on the floor.
    pub(crate) fn draw(
        &self,
        area: &Area<'_>,
        pose: &[Vec3],
        placement: &Placement,
    ) -> Result<(), CodebookError> {
        let heights = pose.iter().map(|joint| joint.y);
        let lowest = heights.fold(f32::INFINITY, f32::min);
        let (x, y) = placement.floor;
        let seen = |joint: Vec3| {
            let (right, up) = (joint.x * SCALE, (joint.y - lowest) * SCALE);
            (x + right.round() as i32, y - up.round() as i32)
        };
        let pale = |half| placement.strong.is_some_and(|strong| strong != half);
        let depth = |limb: &Limb| {
            let sum: f32 = limb.joints.iter().map(|&joint| pose[joint].z).sum();
            sum / limb.joints.len() as f32
        };
        let mut limbs: Vec<&Limb> = self.limbs.iter().collect();
        // Pale limbs first, then those farther from the viewer at +z.
        limbs.sort_by(|a, b| {
            let paler = pale(b.half).cmp(&pale(a.half));
            paler.then(depth(a).total_cmp(&depth(b)))
        });
        for limb in limbs {
            let colour = if pale(limb.half) { PALE } else { limb.colour };
            let points = limb.joints.iter().map(|&joint| seen(pose[joint]));
            let stroke = PathElement::new(points.collect::<Vec<_>>(), colour.stroke_width(WIDTH));
            area.draw(&stroke).map_err(CodebookError::draw)?;
        }
        if let Some([head, neck]) = self.head {
            let up = (pose[head] - pose[neck]).normalize_or_zero();
            let middle = seen(pose[head] + 0.5 * HEAD * up);
            let colour = if pale(Half::Upper) { PALE } else { TRUNK };
            let round = Circle::new(middle, (HEAD * SCALE) as i32, colour.filled());
            area.draw(&round).map_err(CodebookError::draw)?;
        }
        Ok(())
    }
}

/// Turns a pose that faces +z towards the viewer.
pub(crate) fn to_viewer(pose: &[[f32; 3]]) -> Vec<Vec3> {
    let turn = Quat::from_rotation_y(-ASIDE);
    pose.iter().map(|&place| turn * Vec3::from(place)).collect()
}

fn side_colour(skeleton: &Skeleton, joint: usize) -> RGBColor {
    match skeleton.joints[joint].get(..2) {
        Some("l_") => LEFT,
        Some("r_") => RIGHT,
        _ => TRUNK,
    }
}
