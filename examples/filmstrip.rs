//! Draws a dance as a strip of poses, for a README or a quick look:
//!
//! ```text
//! bailando generate song.mp3 -o dance.json
//! cargo run --example filmstrip -- dance.json strip.png --from 5 --seconds 6 --poses 7
//! ```
//!
//! The poses are seen from the front (the dancer's left is on the right, in blue), evenly spaced in
//! time, each with the trails of its hands. On the right is the path over the floor seen from
//! above, the front at the bottom.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use base64::{Engine, engine::general_purpose::STANDARD};
use clap::Parser;
use serde::Deserialize;
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, Transform,
};

const WIDTH: u32 = 1600;
const HEIGHT: u32 = 500;
/// Width of the panel with the path over the floor.
const MAP: f32 = 300.0;
const MARGIN: f32 = 30.0;
/// Height of the floor line, from the top.
const FLOOR: f32 = 450.0;
/// Seconds that the trail of a hand goes back.
const TRAIL: f32 = 0.35;

const PAPER: [u8; 3] = [250, 249, 246];
const GROUND: [u8; 3] = [205, 200, 190];
const SHADE: [u8; 3] = [232, 228, 220];
const BODY: [u8; 3] = [52, 58, 70];
const LEFT: [u8; 3] = [38, 132, 186];
const RIGHT: [u8; 3] = [224, 106, 59];

fn main() -> Result<()> {
    let options = Options::parse();
    let text = std::fs::read(&options.input)
        .with_context(|| format!("can't read {}", options.input.display()))?;
    let dance: Dance = serde_json::from_slice(&text)
        .with_context(|| format!("{} is not a JSON result", options.input.display()))?;
    let picture = draw(&dance.motion()?, &options)?;
    picture.save_png(&options.output)?;
    Ok(())
}

/// Draws a dance as a strip of poses
#[derive(Parser)]
struct Options {
    /// A JSON result
    input: PathBuf,
    /// The picture to write
    #[arg(value_name = "OUT.png")]
    output: PathBuf,
    /// Seconds before the first pose
    #[arg(long, default_value_t = 0.0, value_parser = seconds)]
    from: f32,
    /// Seconds from the first to the last pose [default: to the end]
    #[arg(long, value_parser = seconds)]
    seconds: Option<f32>,
    /// Number of poses
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..=20))]
    poses: u32,
}

fn seconds(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        _ => Err("expected seconds, 0 or more".into()),
    }
}

/// The part of a JSON result that is drawn.
#[derive(Deserialize)]
struct Dance {
    fps: f32,
    skeleton: Skeleton,
    positions: Positions,
}

#[derive(Deserialize)]
struct Skeleton {
    joints: Vec<String>,
    parents: Vec<i32>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Positions {
    Nested(Vec<Pose>),
    Packed(String),
}

/// x y z of every joint, metres.
type Pose = Vec<[f32; 3]>;

struct Motion {
    fps: f32,
    skeleton: Skeleton,
    poses: Vec<Pose>,
}

impl Dance {
    fn motion(self) -> Result<Motion> {
        let joints = self.skeleton.joints.len();
        let poses = match self.positions {
            Positions::Nested(poses) => poses,
            Positions::Packed(text) => {
                let bytes = STANDARD.decode(text)?;
                let (words, _) = bytes.as_chunks::<4>();
                let floats: Vec<f32> = words.iter().map(|w| f32::from_le_bytes(*w)).collect();
                let (places, _) = floats.as_chunks::<3>();
                let poses = places.chunks_exact(joints.max(1));
                poses.map(<[_]>::to_vec).collect()
            }
        };
        ensure!(!poses.is_empty(), "the dance has no frames");
        ensure!(
            self.skeleton.parents.len() == joints && poses.iter().all(|p| p.len() == joints),
            "positions and skeleton don't fit each other"
        );
        Ok(Motion { fps: self.fps, skeleton: self.skeleton, poses })
    }
}

impl Motion {
    fn joint(&self, name: &str) -> Option<usize> {
        self.skeleton.joints.iter().position(|joint| joint == name)
    }

    fn parent(&self, joint: usize) -> Option<usize> {
        let parent = usize::try_from(*self.skeleton.parents.get(joint)?).ok()?;
        (parent < self.skeleton.joints.len()).then_some(parent)
    }

    /// Colour of the bone that ends in `joint`: by side, the trunk neutral.
    fn colour(&self, joint: usize) -> [u8; 3] {
        match self.skeleton.joints[joint].get(..2) {
            Some("l_") => LEFT,
            Some("r_") => RIGHT,
            _ => BODY,
        }
    }
}

fn draw(motion: &Motion, options: &Options) -> Result<Pixmap> {
    let last = motion.poses.len() - 1;
    let first = ((options.from * motion.fps) as usize).min(last);
    let length = options.seconds.map_or(last, |s| (s * motion.fps) as usize);
    let end = (first + length).min(last);
    let poses = options.poses as usize;
    let frame_of = |pose: usize| first + (end - first) * pose / (poses - 1).max(1);

    let mut canvas = Canvas::new()?;
    let strip = WIDTH as f32 - MAP - 2.0 * MARGIN;
    let column = strip / poses as f32;
    let scale = (column / 0.78).min(230.0);
    let floor = [(MARGIN, FLOOR), (MARGIN + strip, FLOOR)];
    canvas.line(&floor, GROUND, 2.0, 1.0);
    for pose in 0..poses {
        let centre = MARGIN + column * (pose as f32 + 0.5);
        draw_pose(&mut canvas, motion, frame_of(pose), centre, scale);
    }
    let marks: Vec<usize> = (0..poses).map(frame_of).collect();
    draw_map(&mut canvas, motion, first..=end, &marks);
    Ok(canvas.pixmap)
}

fn draw_pose(canvas: &mut Canvas, motion: &Motion, frame: usize, centre: f32, scale: f32) {
    let root = motion.poses[frame][0];
    let project = |p: [f32; 3]| (centre + (p[0] - root[0]) * scale, FLOOR - p[1] * scale);
    canvas.ellipse((centre, FLOOR), (0.3 * scale, 0.035 * scale), SHADE);

    let back = (TRAIL * motion.fps) as usize;
    for (hand, colour) in [("l_hand", LEFT), ("r_hand", RIGHT)] {
        let Some(hand) = motion.joint(hand) else {
            continue;
        };
        for before in frame.saturating_sub(back)..frame {
            let age = (frame - before) as f32 / back.max(1) as f32;
            // Relative to the root of that frame, as if the camera followed.
            let then = motion.poses[before][0];
            let seen = |frame: usize| {
                let [x, y, z] = motion.poses[frame][hand];
                project([x - then[0] + root[0], y, z])
            };
            let ends = [seen(before), seen(before + 1)];
            canvas.line(&ends, colour, 3.0, 0.45 * (1.0 - age));
        }
    }

    let pose = &motion.poses[frame];
    let mut bones: Vec<(usize, usize)> =
        (0..pose.len()).filter_map(|joint| Some((motion.parent(joint)?, joint))).collect();
    // The camera stands at +z: nearer bones are drawn later.
    bones.sort_by(|a, b| (pose[a.0][2] + pose[a.1][2]).total_cmp(&(pose[b.0][2] + pose[b.1][2])));
    let width = 0.058 * scale;
    for &(parent, joint) in &bones {
        let ends = [project(pose[parent]), project(pose[joint])];
        canvas.line(&ends, PAPER, width + 3.0, 1.0);
        canvas.line(&ends, motion.colour(joint), width, 1.0);
    }
    if let Some(head) = motion.joint("head") {
        let neck = motion.parent(head).unwrap_or(head);
        let up: [f32; 3] = std::array::from_fn(|axis| pose[head][axis] - pose[neck][axis]);
        let middle = std::array::from_fn(|axis| pose[head][axis] + 0.35 * up[axis]);
        canvas.ellipse(project(middle), (0.095 * scale, 0.115 * scale), BODY);
    }
}

/// Draws the path of the root over the floor: x to the right, z (the front) down.
fn draw_map(
    canvas: &mut Canvas,
    motion: &Motion,
    frames: std::ops::RangeInclusive<usize>,
    marks: &[usize],
) {
    let side = MAP - MARGIN;
    let (left, top) = (WIDTH as f32 - MARGIN - side, FLOOR - side);
    canvas.rectangle((left, top), (side, side), SHADE);
    let places: Vec<(f32, f32)> =
        frames.map(|frame| (motion.poses[frame][0][0], motion.poses[frame][0][2])).collect();
    let bounds = |values: &dyn Fn(&(f32, f32)) -> f32| {
        let low = places.iter().map(values).fold(f32::INFINITY, f32::min);
        let high = places.iter().map(values).fold(f32::NEG_INFINITY, f32::max);
        (0.5 * (low + high), high - low)
    };
    let ((x, wide), (z, deep)) = (bounds(&|p| p.0), bounds(&|p| p.1));
    // A metre of floor around the path, so that small steps are not magnified.
    let scale = side / (wide.max(deep) + 1.0);
    let (middle_x, middle_z) = (left + 0.5 * side, top + 0.5 * side);
    let project = |p: (f32, f32)| (middle_x + (p.0 - x) * scale, middle_z + (p.1 - z) * scale);
    for metre in -20..=20 {
        let (gx, gz) = project((x.round() + metre as f32, z.round() + metre as f32));
        if (left..=left + side).contains(&gx) {
            canvas.line(&[(gx, top), (gx, top + side)], PAPER, 2.0, 1.0);
        }
        if (top..=top + side).contains(&gz) {
            canvas.line(&[(left, gz), (left + side, gz)], PAPER, 2.0, 1.0);
        }
    }
    let way: Vec<(f32, f32)> = places.iter().map(|&p| project(p)).collect();
    canvas.line(&way, BODY, 2.5, 0.8);
    for &frame in marks {
        let pose = &motion.poses[frame];
        let here = project((pose[0][0], pose[0][2]));
        if let (Some(l), Some(r)) = (motion.joint("l_hip"), motion.joint("r_hip")) {
            // From the right hip to the left is +x where the heading is +z: the front is a quarter
            // turn further.
            let (dx, dz) = (pose[l][0] - pose[r][0], pose[l][2] - pose[r][2]);
            let length = dx.hypot(dz).max(1e-6);
            let front = (here.0 - dz / length * 20.0, here.1 + dx / length * 20.0);
            canvas.line(&[here, front], BODY, 4.0, 1.0);
        }
        canvas.ellipse(here, (7.0, 7.0), BODY);
    }
}

struct Canvas {
    pixmap: Pixmap,
}

impl Canvas {
    fn new() -> Result<Self> {
        let mut pixmap = Pixmap::new(WIDTH, HEIGHT).context("no picture of this size")?;
        pixmap.fill(Color::from_rgba8(PAPER[0], PAPER[1], PAPER[2], 255));
        Ok(Self { pixmap })
    }

    fn line(&mut self, points: &[(f32, f32)], colour: [u8; 3], width: f32, opacity: f32) {
        let mut path = PathBuilder::new();
        let Some((&(x, y), rest)) = points.split_first() else {
            return;
        };
        path.move_to(x, y);
        for &(x, y) in rest {
            path.line_to(x, y);
        }
        let stroke = Stroke {
            width,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        if let Some(path) = path.finish() {
            let paint = paint(colour, opacity);
            let plain = Transform::identity();
            self.pixmap.stroke_path(&path, &paint, &stroke, plain, None);
        }
    }

    fn ellipse(&mut self, centre: (f32, f32), radii: (f32, f32), colour: [u8; 3]) {
        let (w, h) = (2.0 * radii.0, 2.0 * radii.1);
        if let Some(frame) = Rect::from_xywh(centre.0 - radii.0, centre.1 - radii.1, w, h) {
            self.fill(PathBuilder::from_oval(frame), colour);
        }
    }

    fn rectangle(&mut self, corner: (f32, f32), size: (f32, f32), colour: [u8; 3]) {
        if let Some(frame) = Rect::from_xywh(corner.0, corner.1, size.0, size.1) {
            self.fill(Some(PathBuilder::from_rect(frame)), colour);
        }
    }

    fn fill(&mut self, path: Option<Path>, colour: [u8; 3]) {
        if let Some(path) = path {
            let paint = paint(colour, 1.0);
            let plain = Transform::identity();
            self.pixmap.fill_path(&path, &paint, FillRule::Winding, plain, None);
        }
    }
}

fn paint(colour: [u8; 3], opacity: f32) -> Paint<'static> {
    let mut paint = Paint::default();
    let [red, green, blue] = colour;
    paint.set_color_rgba8(red, green, blue, (255.0 * opacity) as u8);
    paint.anti_alias = true;
    paint
}
