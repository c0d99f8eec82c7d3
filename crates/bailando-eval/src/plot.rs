//! A plot of generated motions relative to recordings.

use std::fmt::Display;

use plotters::{
    chart::ChartBuilder,
    coord::ranged1d::SegmentValue,
    element::{Circle, PathElement},
    prelude::{IntoDrawingArea, IntoLogRange, IntoSegmentedCoord, SVGBackend},
    style::{BLACK, Color, RGBColor, WHITE},
};

use crate::{error::EvaluationError, metric::Metric, report::Report};

const WIDTH: u32 = 900;
const ROW_HEIGHT: u32 = 30;
/// Title and the axis with its description.
const FRAME_HEIGHT: u32 = 110;
const LABELS_WIDTH: u32 = 240;
const INK: RGBColor = RGBColor(0x1b, 0x6c, 0xa8);
/// The plot shows at least a factor of two to either side.
const NARROWEST: f64 = 2.0;

/// One metric: generated divided by recorded, and the ends of its interval.
struct Row {
    title: &'static str,
    ratio: f64,
    ends: [f64; 2],
}

impl Report {
    /// Draws every metric of the generated motions divided by that of the recordings as an SVG, on
    /// a logarithmic axis, with its 95 % interval where there are several sets. A metric that is
    /// not above zero on both sides has no place on such an axis and is left out.
    ///
    /// # Errors
    /// [`EvaluationError::Plot`] if there is nothing to show, or it can't be drawn.
    pub fn svg(&self) -> Result<String, EvaluationError> {
        let rows: Vec<Row> = Metric::all().filter_map(|metric| self.ratio(metric)).collect();
        if rows.is_empty() {
            return Err(EvaluationError::Plot("no metric has a ratio".into()));
        }
        let mut svg = String::new();
        self.draw(&rows, &mut svg).map_err(EvaluationError::Plot)?;
        Ok(svg)
    }

    fn ratio(&self, metric: Metric) -> Option<Row> {
        let recorded = self.reference.get(metric).filter(|value| *value > 0.0)?;
        let generated = self.generated.get(metric).filter(|value| *value > 0.0)?;
        let margin = self.margin95.get(metric.key()).copied().unwrap_or(0.0);
        let ratio = generated / recorded;
        // An interval that reaches below zero ends at the edge of what can be shown.
        let low = ((generated - margin) / recorded).max(ratio / 16.0);
        Some(Row { title: metric.title(), ratio, ends: [low, (generated + margin) / recorded] })
    }

    fn draw(&self, rows: &[Row], svg: &mut String) -> Result<(), String> {
        let ends = rows.iter().flat_map(|row| row.ends);
        let farthest = ends.map(|end| end.max(1.0 / end));
        let limit = 1.1 * farthest.fold(NARROWEST, f64::max);
        let size = (WIDTH, FRAME_HEIGHT + ROW_HEIGHT * rows.len() as u32);
        let area = SVGBackend::with_string(svg, size).into_drawing_area();
        area.fill(&WHITE).map_err(text)?;
        let ratios = (1.0 / limit..limit).log_scale();
        let caption = "Generated motions relative to recordings";
        let mut chart = ChartBuilder::on(&area)
            .caption(caption, ("sans-serif", 20))
            .margin(12)
            .x_label_area_size(48)
            .y_label_area_size(LABELS_WIDTH)
            .build_cartesian_2d(ratios, (0..rows.len()).into_segmented())
            .map_err(text)?;
        // The first row on top.
        let row_at = |place: usize| rows.get(rows.len().checked_sub(place + 1)?);
        let title = |value: &SegmentValue<usize>| match value {
            SegmentValue::CenterOf(place) => row_at(*place).map_or("", |row| row.title).to_owned(),
            _ => String::new(),
        };
        chart
            .configure_mesh()
            .light_line_style(WHITE.mix(0.0))
            .y_labels(rows.len())
            .y_label_formatter(&title)
            .x_label_formatter(&|ratio| format!("{ratio:.2}"))
            .x_desc(self.axis())
            .draw()
            .map_err(text)?;
        let middle = SegmentValue::CenterOf;
        let one = [(1.0, SegmentValue::Exact(0)), (1.0, SegmentValue::Last)];
        let line = PathElement::new(one, BLACK);
        chart.draw_series([line]).map_err(text)?;
        for place in 0..rows.len() {
            if let Some(row) = row_at(place) {
                let interval = row.ends.map(|end| (end, middle(place))).to_vec();
                let whisker = PathElement::new(interval, INK.stroke_width(2));
                chart.draw_series([whisker]).map_err(text)?;
                let dot = Circle::new((row.ratio, middle(place)), 5, INK.filled());
                chart.draw_series([dot]).map_err(text)?;
            }
        }
        area.present().map_err(text)
    }

    fn axis(&self) -> String {
        match self.sets.len() {
            0 => "generated / recorded".into(),
            sets => format!("generated / recorded, mean of {sets} sets and 95 % interval"),
        }
    }
}

fn text(error: impl Display) -> String {
    error.to_string()
}
