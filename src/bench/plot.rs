//! A plot of time by length of the song.

use std::fmt::Display;

use plotters::{
    chart::ChartBuilder,
    element::Circle,
    prelude::{IntoDrawingArea, SVGBackend},
    series::{DashedLineSeries, LineSeries},
    style::{BLACK, Color, RGBColor, WHITE},
};

use super::report::Bench;

const SIZE: (u32, u32) = (900, 480);
const INK: RGBColor = RGBColor(0x1b, 0x6c, 0xa8);

impl Bench {
    /// Draws seconds by length of the song as an SVG, beside a straight line through the first
    /// point.
    ///
    /// # Errors
    /// The message of the drawing library.
    pub fn lengths_svg(&self) -> Result<String, String> {
        let points = self.lengths.iter();
        let points: Vec<(f64, f64)> = points.map(|p| (p.seconds, p.elapsed_s)).collect();
        let largest = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).fold(1e-3, f64::max);
        let (longest, slowest) = (largest(|point| point.0), largest(|point| point.1));
        let slope = points.first().map_or(0.0, |(length, time)| time / length);
        let top = 1.05 * slowest.max(slope * longest);
        let mut svg = String::new();
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE).map_err(text)?;
        let caption = format!("Song to BVH, {} ({} threads)", self.model, self.threads);
        let mut chart = ChartBuilder::on(&area)
            .caption(caption, ("sans-serif", 20))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..1.05 * longest, 0.0..top)
            .map_err(text)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc("seconds of music")
            .y_desc("seconds of work")
            .draw()
            .map_err(text)?;
        let straight = [(0.0, 0.0), (longest, slope * longest)];
        chart
            .draw_series(DashedLineSeries::new(straight, 6, 4, BLACK.stroke_width(1)))
            .map_err(text)?;
        chart
            .draw_series(LineSeries::new(points.iter().copied(), INK.stroke_width(2)))
            .map_err(text)?;
        let dot = |&point: &(f64, f64)| Circle::new(point, 4, INK.filled());
        chart.draw_series(points.iter().map(dot)).map_err(text)?;
        area.present().map_err(text)?;
        drop(chart);
        drop(area);
        Ok(svg)
    }
}

fn text(error: impl Display) -> String {
    error.to_string()
}
