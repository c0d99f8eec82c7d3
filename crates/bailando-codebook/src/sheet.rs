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

use super::{
    Catalogue, CodePose, CodebookError, Half, Transition,
    facing::{bodies_to_front, halves_to_front},
    figure::{Area, FLOOR, Figure, Stand, drawn, to_viewer},
    transition::POSES,
};

/// Room of one figure, pixels.
const CELL: (u32, u32) = (160, 212);
/// Where the floor is in it.
const GROUND: i32 = 182;
const TITLE_HEIGHT: u32 = 64;
const MARGIN: i32 = 14;
/// Left of a film strip: what changes into what.
const LABEL_WIDTH: u32 = 190;
/// A film strip's figures stand closer.
const FRAME_WIDTH: u32 = 130;
/// The dial that shows where a code faces.
const DIAL: (i32, i32, i32) = (140, 20, 11);

const INK: RGBColor = RGBColor(52, 58, 70);
const FAINT: RGBColor = RGBColor(140, 140, 136);

/// In which order codes are shown.
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
        let (name, other) = match half {
            Half::Upper => ("Upper", Half::Lower),
            Half::Lower => ("Lower", Half::Upper),
        };
        let title = format!("{name} codes of {}", self.model);
        let (other, neutral) = (other.name(), self.half(other).neutral);
        let mut note = format!("grey: {other} code {neutral}");
        if self.motion_frame.is_world() {
            note += "; dial: where the code faces, seen from above, the viewer below";
        }
        let mut svg = String::new();
        let size = (columns * CELL.0, TITLE_HEIGHT + rows * CELL.1);
        {
            let area = page(&mut svg, size, &title, &note)?;
            let figure = Figure::new(self);
            let cells = area.split_evenly((rows as usize, columns as usize));
            for (code, cell) in codes.into_iter().zip(&cells) {
                self.draw_code(&figure, cell, half, code)?;
            }
            area.present().map_err(drawn)?;
        }
        Ok(svg)
    }

    fn draw_code(
        &self,
        figure: &Figure,
        cell: &Area<'_>,
        half: Half,
        code: &CodePose,
    ) -> Result<(), CodebookError> {
        let (pose, facings) = halves_to_front(&code.pose, &self.upper.joints);
        let middle = CELL.0 as i32 / 2;
        draw_floor(cell, middle)?;
        let stand = Stand {
            floor: (middle, GROUND),
            strong: Some(half),
        };
        figure.draw(cell, &to_viewer(&pose), &stand)?;
        if self.motion_frame.is_world() {
            draw_dial(cell, *half.of(&facings))?;
        }
        let number = code.code.to_string();
        let place = (middle, GROUND + 4);
        let label = match code.uses {
            None => number,
            Some(uses) => format!("{number} ({uses}×)"),
        };
        write(cell, &label, place, HPos::Center, (22, INK))
    }

    /// An SVG with a film strip for every change.
    ///
    /// # Errors
    /// [`CodebookError::Draw`].
    pub fn transitions_sheet(&self) -> Result<String, CodebookError> {
        let rows = self.transitions.len() as u32;
        let title = format!(
            "Pairs of codes of {}, and how one becomes the next",
            self.model
        );
        let mut svg = String::new();
        let width = LABEL_WIDTH + POSES as u32 * FRAME_WIDTH;
        {
            let size = (width, TITLE_HEIGHT + rows * CELL.1);
            let area = page(
                &mut svg,
                size,
                &title,
                "upper / lower code; two poses a code",
            )?;
            let figure = Figure::new(self);
            let strips = area.split_evenly((rows.max(1) as usize, 1));
            for (transition, strip) in self.transitions.iter().zip(&strips) {
                draw_strip(&figure, strip, transition)?;
            }
            area.present().map_err(drawn)?;
        }
        Ok(svg)
    }
}

fn draw_strip(
    figure: &Figure,
    strip: &Area<'_>,
    transition: &Transition,
) -> Result<(), CodebookError> {
    let poses = bodies_to_front(&transition.poses);
    for (index, pose) in poses.iter().enumerate() {
        let middle =
            LABEL_WIDTH as i32 + FRAME_WIDTH as i32 * index as i32 + FRAME_WIDTH as i32 / 2;
        draw_floor(strip, middle)?;
        let stand = Stand {
            floor: (middle, GROUND),
            strong: None,
        };
        figure.draw(strip, &to_viewer(pose), &stand)?;
    }
    let pair = |[upper, lower]: [u32; 2]| format!("{upper} / {lower}");
    let (from, to) = (pair(transition.from), pair(transition.to));
    write(strip, &from, (MARGIN, 60), HPos::Left, (24, INK))?;
    write(
        strip,
        &format!("→ {to}"),
        (MARGIN, 92),
        HPos::Left,
        (24, INK),
    )?;
    match transition.uses {
        None => Ok(()),
        Some(uses) => write(
            strip,
            &format!("{uses}×"),
            (MARGIN, 126),
            HPos::Left,
            (20, FAINT),
        ),
    }
}

/// A white page with its title; what is left below.
fn page<'a>(
    svg: &'a mut String,
    size: (u32, u32),
    title: &str,
    note: &str,
) -> Result<Area<'a>, CodebookError> {
    let area = SVGBackend::with_string(svg, size).into_drawing_area();
    area.fill(&WHITE).map_err(drawn)?;
    let (head, rest) = area.split_vertically(TITLE_HEIGHT);
    write(&head, title, (MARGIN, 8), HPos::Left, (24, INK))?;
    write(&head, note, (MARGIN, 38), HPos::Left, (17, FAINT))?;
    Ok(rest)
}

fn draw_floor(cell: &Area<'_>, middle: i32) -> Result<(), CodebookError> {
    let ends = [(middle - 52, GROUND + 2), (middle + 52, GROUND + 2)];
    let line = PathElement::new(ends, FLOOR.stroke_width(3));
    cell.draw(&line).map_err(drawn)
}

/// A floor seen from above, the viewer at +z below it, and a hand that points where a code faces.
fn draw_dial(cell: &Area<'_>, facing: f32) -> Result<(), CodebookError> {
    let (x, y, radius) = DIAL;
    let (sin, cos) = facing.sin_cos();
    let end = |part: f32| (part * radius as f32).round() as i32;
    let hand = [(x, y), (x + end(sin), y + end(cos))];
    let round = Circle::new((x, y), radius, FLOOR.filled());
    cell.draw(&round).map_err(drawn)?;
    let hand = PathElement::new(hand, INK.stroke_width(3));
    cell.draw(&hand).map_err(drawn)
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
    area.draw_text(text, &style, place).map_err(drawn)
}
