//! Draws learning curves as SVG and PNG.

use kuva::backend::png::PngBackend;
use kuva::backend::svg::SvgBackend;
use kuva::plot::{LegendPosition, LinePlot, LineStyle};
use kuva::render::layout::{Layout, TickFormat};
use kuva::render::plots::Plot;
use kuva::render::render::{Scene, render_multiple};

use std::sync::Arc;

use crate::chart;
use crate::learning_curve::Series;
use crate::palette::{OKABE_ITO, Rgb, hex};

/// Colours that a thin line on white can have.
const COLOURS: [Rgb; 7] = *OKABE_ITO.first_chunk().expect("the palette has more");

/// Size of the axes' area in SVG units; the PNG has twice as many pixels.
const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 420.0;

/// A picture in both forms.
pub(crate) struct Picture {
    /// Text of the SVG; its viewer supplies the font, which would be most of the file.
    pub(crate) svg: String,
    /// Bytes of the PNG.
    pub(crate) png: Vec<u8>,
}

/// One panel: evaluation return over environment steps.
pub(crate) fn draw(series: &[Series], title: &str) -> anyhow::Result<Picture> {
    let scene = scene(series, title);
    let png = PngBackend::new().with_scale(2.0).render_scene(&scene).map_err(anyhow::Error::msg)?;
    Ok(Picture { svg: SvgBackend::new().render_scene(&scene), png })
}

fn scene(series: &[Series], title: &str) -> Scene {
    let plots: Vec<Plot> = series.iter().enumerate().map(|(i, s)| Plot::Line(line(i, s))).collect();
    let steps = TickFormat::Custom(Arc::new(short_count));
    let mut layout = Layout::auto_from_plots(&plots)
        .with_width(WIDTH)
        .with_height(HEIGHT)
        .with_title(title)
        .with_x_label("environment steps")
        .with_y_label("evaluation return")
        .with_x_tick_format(steps)
        .with_legend_position(LegendPosition::OutsideBottomColumns)
        .with_legend_box(false)
        .with_grid_line_width(0.5);
    if series.iter().any(|series| series.runs > 1) {
        layout = layout.with_subtitle("mean over seeds, shaded from the lowest to the highest");
    }
    render_multiple(plots, layout)
}

fn line(index: usize, series: &Series) -> LinePlot {
    let style = match index / COLOURS.len() {
        0 => LineStyle::Solid,
        1 => LineStyle::Dashed,
        _ => LineStyle::Dotted,
    };
    let line = LinePlot::new()
        .with_data(series.points.iter().map(|point| (point.env_steps, point.mean)))
        .with_color(hex(COLOURS[index % COLOURS.len()]))
        .with_stroke_width(2.0)
        .with_line_style(style)
        .with_legend(series.label.as_str());
    if series.runs < 2 {
        return line;
    }
    let points = &series.points;
    line.with_band(points.iter().map(|p| p.low), points.iter().map(|p| p.high))
}

/// `250k`, `1M`, `2.5M`; counts below a thousand in full.
fn short_count(count: f64) -> String {
    let (scaled, unit) = match count.abs() {
        size if size >= 1e6 => (count / 1e6, "M"),
        size if size >= 1e3 => (count / 1e3, "k"),
        _ => return chart::thousands(count.max(0.0) as u64),
    };
    let text = format!("{scaled:.2}");
    format!("{}{unit}", text.trim_end_matches('0').trim_end_matches('.'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning_curve::Point;

    fn rising(label: &str, runs: usize) -> Series {
        let point = |k: u32| {
            let mean = 2000.0 * f64::from(k) / f64::from(k + 3);
            let env_steps = f64::from(k) * 100_000.0;
            Point { env_steps, mean, low: mean - 150.0, high: mean + 120.0 }
        };
        Series { label: label.into(), runs, points: (0..=10).map(point).collect() }
    }

    #[test]
    fn both_forms_hold_the_curves() {
        let picture =
            draw(&[rising("happo (3 seeds)", 3), rising("other (seed 1)", 1)], "a task").unwrap();
        assert!(picture.svg.starts_with("<svg") && picture.svg.contains("happo (3 seeds)"));
        assert!(picture.svg.contains(&hex(COLOURS[0])) && picture.svg.contains(&hex(COLOURS[1])));
        assert!(picture.png.starts_with(b"\x89PNG"));
    }

    #[test]
    fn env_steps_are_written_short() {
        assert_eq!(short_count(0.0), "0");
        assert_eq!(short_count(250_000.0), "250k");
        assert_eq!(short_count(1_000_000.0), "1M");
        assert_eq!(short_count(2_500_000.0), "2.5M");
    }
}
