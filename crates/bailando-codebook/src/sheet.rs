//! Sheets of figures: every code of a half in a grid, and changes as film strips.

use std::cmp::Reverse;

use plotters::{
    element::{Circle, PathElement},
    prelude::{IntoDrawingArea, IntoFont, SVGBackend},
    style::{
        Color, RGBColor, TextStyle, WHITE,
        text_anchor::{HPos, Pos, VPos},
    },
};

use crate::{
    catalogue::{Catalogue, CodePose},
    error::CodebookError,
    figure::{Area, FLOOR, Figure, Placement, to_viewer},
    half::Half,
    heading::{bodies_to_front, halves_to_front},
    transition::{POSES, Transition},
};

/// Width and height of one figure's cell, pixels.
const CELL: (u32, u32) = (160, 212);
/// Height of the floor in a cell, from its top.
const GROUND: i32 = 182;
const TITLE_HEIGHT: u32 = 64;
const MARGIN: i32 = 14;
/// Left of a film strip: the two pairs.
const LABEL_WIDTH: i32 = 190;
/// A film strip's figures stand closer.
const FRAME_WIDTH: i32 = 130;
/// The dial that shows a code's heading: x, y and radius.
const DIAL: (i32, i32, i32) = (140, 20, 11);

const INK: RGBColor = RGBColor(52, 58, 70);
const FAINT: RGBColor = RGBColor(140, 140, 136);

/// The order of codes on a sheet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// By number.
    #[default]
    Number,
    /// The most used first.
    Uses,
}

impl Catalogue {
    /// An SVG with a figure for every code of `half`, `columns` in a row.
    ///
    /// # Errors
    /// [`CodebookError::Draw`].
    pub fn sheet(&self, half: Half, columns: u32, order: Order) -> Result<String, CodebookError> {
        let mut codes: Vec<&CodePose> = self.half(half).codes.iter().collect();
        if order == Order::Uses {
            codes.sort_by_key(|code| Reverse(code.uses));
        }
        let columns = columns.clamp(1, codes.len().max(1) as u32);
        let rows = (codes.len() as u32).div_ceil(columns);
        let name = match half {
            Half::Upper => "Upper",
            Half::Lower => "Lower",
        };
        let title = format!("{name} codes of {}", self.model);
        let (other, neutral) = (half.other().name(), self.half(half.other()).neutral);
        let mut note = format!("grey: {other} code {neutral}");
        if self.motion_frame.is_world() {
            note += "; dial: heading of the code, seen from above, the viewer below";
        }
        let size = (columns * CELL.0, TITLE_HEIGHT + rows * CELL.1);
        drawn(size, [&title, &note], |area| {
            let figure = self.figure();
            let cells = area.split_evenly((rows as usize, columns as usize));
            let mut pairs = codes.iter().zip(&cells);
            pairs.try_for_each(|(code, cell)| self.draw_code(&figure, cell, half, code))
        })
    }

    fn draw_code(
        &self,
        figure: &Figure,
        cell: &Area<'_>,
        half: Half,
        code: &CodePose,
    ) -> Result<(), CodebookError> {
        let (pose, headings) = halves_to_front(&code.pose, &self.upper.joints);
        let middle = CELL.0 as i32 / 2;
        draw_figure(figure, cell, middle, &pose, Some(half))?;
        if self.motion_frame.is_world() {
            draw_dial(cell, *half.of(&headings))?;
        }
        let number = code.code.to_string();
        let label = match code.uses {
            None => number,
            Some(uses) => format!("{number} ({uses}×)"),
        };
        let place = (middle, GROUND + 4);
        write(cell, &label, place, HPos::Center, (22, INK))
    }

    /// An SVG with a film strip for every change.
    ///
    /// # Errors
    /// [`CodebookError::Draw`].
    pub fn transitions_sheet(&self) -> Result<String, CodebookError> {
        let rows = self.transitions.len() as u32;
        let title = format!("Pairs of codes of {}, and how one becomes the next", self.model);
        let note = "upper / lower code; two poses a code";
        let width = LABEL_WIDTH as u32 + POSES as u32 * FRAME_WIDTH as u32;
        drawn((width, TITLE_HEIGHT + rows * CELL.1), [&title, note], |area| {
            let figure = self.figure();
            let strips = area.split_evenly((rows.max(1) as usize, 1));
            let mut pairs = self.transitions.iter().zip(&strips);
            pairs.try_for_each(|(transition, strip)| draw_strip(&figure, strip, transition))
        })
    }

    fn figure(&self) -> Figure {
        Figure::new(&self.skeleton, &self.upper.joints)
    }
}

fn draw_strip(
    figure: &Figure,
    strip: &Area<'_>,
    transition: &Transition,
) -> Result<(), CodebookError> {
    for (index, pose) in bodies_to_front(&transition.poses).iter().enumerate() {
        let middle = LABEL_WIDTH + FRAME_WIDTH * index as i32 + FRAME_WIDTH / 2;
        draw_figure(figure, strip, middle, pose, None)?;
    }
    let pair = |[upper, lower]: [u32; 2]| format!("{upper} / {lower}");
    let (from, to) = (pair(transition.from), format!("→ {}", pair(transition.to)));
    write(strip, &from, (MARGIN, 60), HPos::Left, (24, INK))?;
    write(strip, &to, (MARGIN, 92), HPos::Left, (24, INK))?;
    if let Some(uses) = transition.uses {
        let uses = format!("{uses}×");
        write(strip, &uses, (MARGIN, 126), HPos::Left, (20, FAINT))?;
    }
    Ok(())
}

/// Returns a white SVG with a title and a note, and below them what `content` draws.
fn drawn(
    size: (u32, u32),
    [title, note]: [&str; 2],
    content: impl FnOnce(&Area<'_>) -> Result<(), CodebookError>,
) -> Result<String, CodebookError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE).map_err(CodebookError::draw)?;
        let (head, rest) = area.split_vertically(TITLE_HEIGHT);
        write(&head, title, (MARGIN, 8), HPos::Left, (24, INK))?;
        write(&head, note, (MARGIN, 38), HPos::Left, (17, FAINT))?;
        content(&rest)?;
        area.present().map_err(CodebookError::draw)?;
    }
    Ok(svg)
}

fn draw_figure(
    figure: &Figure,
    area: &Area<'_>,
    middle: i32,
    pose: &[[f32; 3]],
    strong: Option<Half>,
) -> Result<(), CodebookError> {
    let ends = [(middle - 52, GROUND + 2), (middle + 52, GROUND + 2)];
    let floor = PathElement::new(ends, FLOOR.stroke_width(3));
    area.draw(&floor).map_err(CodebookError::draw)?;
    let floor = (middle, GROUND);
    figure.draw(area, &to_viewer(pose), &Placement { floor, strong })
}

/// Draws a floor seen from above, the viewer at +z below it, with a hand for a code's heading.
fn draw_dial(cell: &Area<'_>, heading: f32) -> Result<(), CodebookError> {
    let (x, y, radius) = DIAL;
    let (sin, cos) = heading.sin_cos();
    let end = |part: f32| (part * radius as f32).round() as i32;
    let hand = [(x, y), (x + end(sin), y + end(cos))];
    let round = Circle::new((x, y), radius, FLOOR.filled());
    cell.draw(&round).map_err(CodebookError::draw)?;
    let hand = PathElement::new(hand, INK.stroke_width(3));
    cell.draw(&hand).map_err(CodebookError::draw)
}

fn write(
    area: &Area<'_>,
    text: &str,
    place: (i32, i32),
    side: HPos,
    (size, colour): (u32, RGBColor),
) -> Result<(), CodebookError> {
    let font = ("sans-serif", size).into_font().color(&colour);
    let style: TextStyle<'_> = font.pos(Pos::new(side, VPos::Top));
    area.draw_text(text, &style, place).map_err(CodebookError::draw)
}
