//! Line charts as SVG.

use std::{fmt::Display, ops::Range};

use plotters::{
    chart::{ChartBuilder, SeriesLabelPosition},
    coord::Shift,
    element::{Circle, PathElement},
    prelude::{DrawingArea, IntoDrawingArea, SVGBackend},
    series::LineSeries,
    style::{BLACK, Color, RGBColor, WHITE},
};

const WIDTH: u32 = 900;
const CHART_HEIGHT: u32 = 380;
const LABELS_WIDTH: u32 = 72;
/// In the order of the lines.
const INKS: [RGBColor; 4] = [
    RGBColor(0x1b, 0x6c, 0xa8),
    RGBColor(0xd1, 0x5b, 0x1f),
    RGBColor(0x2e, 0x8b, 0x57),
    RGBColor(0x7d, 0x3c, 0x98),
];
/// Lines of so few points show the points as well.
const FEW: usize = 40;
/// Share of the values' span that is left free above and below.
const MARGIN: f64 = 0.05;

/// One chart, over steps.
pub(super) struct Chart<'a> {
    pub(super) title: String,
    pub(super) lines: Vec<Line<'a>>,
}

/// One curve and its name.
pub(super) struct Line<'a> {
    pub(super) label: &'a str,
    pub(super) points: &'a [(u64, f64)],
}

/// Charts below each other in one SVG.
pub(super) fn draw(charts: &[Chart<'_>]) -> Result<String, String> {
    let mut svg = String::new();
    let size = (WIDTH, CHART_HEIGHT * charts.len() as u32);
    let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
    area.fill(&WHITE).map_err(text)?;
    for (chart, place) in charts.iter().zip(area.split_evenly((charts.len(), 1))) {
        draw_chart(chart, &place)?;
    }
    area.present().map_err(text)?;
    drop(area);
    Ok(svg)
}

fn draw_chart(chart: &Chart<'_>, area: &DrawingArea<SVGBackend<'_>, Shift>) -> Result<(), String> {
    let points = || chart.lines.iter().flat_map(|line| line.points);
    let last = points().map(|&(step, _)| step).max().unwrap_or(1) as f64;
    let heights = range(points().map(|&(_, value)| value));
    let decimals = decimals(heights.end - heights.start);
    let mut canvas = ChartBuilder::on(area)
        .caption(&chart.title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(LABELS_WIDTH)
        .build_cartesian_2d(0.0..last, heights)
        .map_err(text)?;
    canvas
        .configure_mesh()
        .light_line_style(WHITE.mix(0.0))
        .label_style(("sans-serif", 14))
        .x_label_formatter(&|step| format!("{step:.0}"))
        .y_label_formatter(&|value| format!("{value:.decimals$}"))
        .x_desc("step")
        .draw()
        .map_err(text)?;
    for (line, ink) in chart.lines.iter().zip(INKS.iter().cycle()) {
        let points = line.points.iter().map(|&(step, value)| (step as f64, value));
        let stroke = ink.stroke_width(2);
        canvas
            .draw_series(LineSeries::new(points.clone(), stroke))
            .map_err(text)?
            .label(line.label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], stroke));
        if line.points.len() <= FEW {
            let dots = points.map(|point| Circle::new(point, 3, ink.filled()));
            canvas.draw_series(dots).map_err(text)?;
        }
    }
    canvas
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font(("sans-serif", 14))
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.2))
        .draw()
        .map_err(text)
}

/// From a little below the lowest value to a little above the highest.
fn range(values: impl Iterator<Item = f64> + Clone) -> Range<f64> {
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    let span = high - low;
    let margin = if span > 0.0 { span * MARGIN } else { low.abs().max(1.0) * MARGIN };
    low - margin..high + margin
}

/// Returns the decimals that resolve a tenth of `span`.
fn decimals(span: f64) -> usize {
    (1.0 - span.log10().floor()).clamp(0.0, 8.0) as usize
}

fn text(error: impl Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_fit_the_values() {
        assert_eq!(range([1.0, 3.0, 2.0].into_iter()), 0.9..3.1);
        assert_eq!(range([4.0].into_iter()), 3.8..4.2);
        assert_eq!(range([0.0].into_iter()), -0.05..0.05);
        assert_eq!([250.0, 20.0, 2.0, 0.02].map(decimals), [0, 0, 1, 3]);
    }

    #[test]
    fn every_line_is_drawn_and_named() {
        let (falling, few) = ([(0, 2.0), (50, 1.0), (100, 0.5)], [(100, 0.75)]);
        let line = |label, points| Line { label, points };
        let chart = |title: &str, lines| Chart { title: title.to_owned(), lines };
        let one = chart("gpt: loss", vec![line("loss", &falling), line("test_loss", &few)]);
        let svg = draw(&[one]).unwrap();
        for wanted in ["gpt: loss", "\nloss\n", "\ntest_loss\n", "step"] {
            assert!(svg.contains(wanted), "{wanted}: {svg}");
        }
        assert_eq!(svg.matches("<circle").count(), 4);
        let two = [chart("a", vec![line("x", &falling)]), chart("b", vec![line("y", &few)])];
        assert!(draw(&two).unwrap().contains("height=\"760\""));
    }
}
