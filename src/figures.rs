//! Pictures of learning curves as SVG and PNG files: one panel per task, or the ablation with its terms below.

pub(crate) mod chart;
pub(crate) mod learning_curve;
pub(crate) mod statistics;
pub(crate) mod style;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use kuva::backend::png::PngBackend;
use kuva::backend::svg::SvgBackend;
use kuva::plot::{BandPlot, LinePlot, ScatterPlot};
use kuva::render::figure::Figure;
use kuva::render::layout::{Layout, TickFormat};
use kuva::render::plots::Plot;
use kuva::render::render::Scene;

use crate::figures::learning_curve::{Curve, Panel, Point, Quantity, Series, panels};
use crate::figures::statistics::Interval;
use crate::figures::style::{MARK, STROKE, colour, legend, line_style, marker};
use crate::process::target;

/// Panels in a row of a picture with many tasks.
const MOST_COLUMNS: usize = 3;

/// Name of the picture of the returns.
pub(crate) const LEARNING_CURVE: &str = "learning_curve";

/// Name of the picture of returns and terms.
pub(crate) const ABLATION: &str = "ablation";

const ENDINGS: [&str; 2] = ["svg", "png"];

/// Marks on one curve, about.
const MARKS: usize = 6;

/// Size of a lone panel's axes in SVG units; the PNG has twice as many pixels.
const WIDTH: f64 = 720.0;

const HEIGHT: f64 = 420.0;

/// Size of a panel among others; one that has a row to itself is as wide as a lone one.
const CELL_WIDTH: f64 = 340.0;

const CELL_HEIGHT: f64 = 270.0;

/// Width of a letter of the legend, and of a mark with its margins.
const LETTER_WIDTH: f64 = 6.6;

const MARK_WIDTH: f64 = 70.0;

/// Marks on an axis, about.
const TICKS: usize = 4;

/// How visible the two bands are.
const RANGE_OPACITY: f64 = 0.26;

const CONFIDENCE_OPACITY: f64 = 0.13;

/// Most curves of a panel with both bands.
const MOST_WITH_RANGES: usize = 3;

/// The files of the picture `name` in a folder.
pub(crate) fn paths(folder: &Path, name: &str) -> [PathBuf; 2] {
    ENDINGS.map(|ending| folder.join(format!("{name}.{ending}")))
}

/// Writes `learning_curve.svg` and `.png`: the return on each task.
pub(crate) fn write_learning_curve(
    folder: &Path,
    curves: &[Curve],
) -> anyhow::Result<Vec<PathBuf>> {
    let panels = panels(curves, &[Quantity::Return]);
    let columns = panels.len().clamp(1, MOST_COLUMNS);
    write(paths(folder, LEARNING_CURVE), &panels, columns)
}

/// Writes `ablation.svg` and `.png`: a column for each task; a row for each of return, surprise and information that
/// some run has.
pub(crate) fn write_ablation(folder: &Path, curves: &[Curve]) -> anyhow::Result<Vec<PathBuf>> {
    let measured = |quantity: &Quantity| curves.iter().any(|curve| !curve.of(*quantity).is_empty());
    let quantities: Vec<Quantity> = Quantity::ALL.into_iter().filter(measured).collect();
    let panels = panels(curves, &quantities);
    let columns = panels.len() / quantities.len().max(1);
    write(paths(folder, ABLATION), &panels, columns)
}

fn write(paths: [PathBuf; 2], panels: &[Panel], columns: usize) -> anyhow::Result<Vec<PathBuf>> {
    let picture = draw(panels, columns)?;
    let contents = [picture.svg.into_bytes(), picture.png];
    let written = paths.into_iter().zip(contents).map(|(path, bytes)| {
        target::file(&path, &bytes)?;
        Ok(path)
    });
    written.collect()
}

/// Bands around the curves of a picture.
#[derive(Clone, Copy, PartialEq)]
enum Bands {
    /// No curve has several runs.
    Neither,
    /// Confidence interval only: ranges of many curves would cover each other.
    Confidence,
    /// Confidence interval and interquartile range.
    Both,
}

impl Bands {
    fn of(panels: &[Panel]) -> Self {
        let is_crowded = |panel: &Panel| panel.series.len() > MOST_WITH_RANGES;
        if !panels.iter().flat_map(|panel| &panel.series).any(has_bands) {
            Self::Neither
        } else if panels.iter().any(is_crowded) {
            Self::Confidence
        } else {
            Self::Both
        }
    }

    fn caption(self) -> Option<&'static str> {
        match self {
            Self::Neither => None,
            Self::Confidence => {
                Some("interquartile mean over seeds and its 95 % confidence interval")
            }
            Self::Both => Some(
                "interquartile mean over seeds; pale: its 95 % confidence interval, dark: interquartile range",
            ),
        }
    }
}

/// A picture in both forms.
struct Picture {
    /// Text of the SVG; its viewer supplies the font, which would be most of the file.
    svg: String,
    /// Bytes of the PNG.
    png: Vec<u8>,
}

/// Panels row by row, `columns` of them in each, with one legend.
fn draw(panels: &[Panel], columns: usize) -> anyhow::Result<Picture> {
    let scene = grid(panels, columns);
    let png = PngBackend::new().with_scale(2.0).render_scene(&scene).map_err(anyhow::Error::msg)?;
    Ok(Picture { svg: SvgBackend::new().render_scene(&scene), png })
}

/// One series for each label of the panels, in order of rank.
fn distinct(panels: &[Panel]) -> Vec<&Series> {
    let all = panels.iter().flat_map(|panel| &panel.series);
    let mut series: Vec<&Series> = all.collect();
    series.sort_by_key(|series| series.rank);
    series.dedup_by(|left, right| left.label == right.label);
    series
}

fn grid(panels: &[Panel], columns: usize) -> Scene {
    let bands = Bands::of(panels);
    let all: Vec<Vec<Plot>> = panels.iter().map(|panel| plots(panel, bands)).collect();
    let small = |(panel, plots): (&Panel, &Vec<Plot>)| {
        layout(panel, plots).with_ticks(TICKS).with_title_size(15)
    };
    let layouts = panels.iter().zip(&all).map(small).collect();
    let (width, height) = match (panels.len(), columns) {
        (1, _) => (WIDTH, HEIGHT),
        (_, 1) => (WIDTH, CELL_HEIGHT),
        _ => (CELL_WIDTH, CELL_HEIGHT),
    };
    let legend = legend(&distinct(panels));
    let longest = legend.iter().map(|entry| entry.label.chars().count()).max().unwrap_or(0);
    let row = MARK_WIDTH + LETTER_WIDTH * longest as f64;
    let width = f64::max(width, row / columns as f64);
    let mut figure = Figure::new(panels.len().div_ceil(columns), columns)
        .with_structure((0..panels.len()).map(|panel| vec![panel]).collect())
        .with_plots(all)
        .with_layouts(layouts)
        .with_cell_size(width, height)
        .with_shared_legend_bottom()
        .with_shared_legend_entries(legend);
    if let Some(caption) = bands.caption() {
        figure = figure.with_title(caption).with_title_size(14);
    }
    figure.render()
}

fn has_bands(series: &Series) -> bool {
    series.runs > 1
}

fn layout(panel: &Panel, plots: &[Plot]) -> Layout {
    let axes = Layout::auto_from_plots(plots);
    let largest = axes.data_y_range.map_or(0.0, |(low, high)| f64::max(low.abs(), high.abs()));
    let axes = match axes.data_y_range {
        Some((lowest, _)) if lowest.is_finite() => axes.with_y_axis_min(lowest),
        _ => Layout::new((0.0, 1.0), (0.0, 1.0)),
    };
    axes.with_title(panel.task.clone())
        .with_x_label("environment steps")
        .with_y_label(panel.quantity.label())
        .with_y_tick_format(panel.quantity.tick_format(largest))
        .with_x_tick_format(TickFormat::Custom(Arc::new(short_count)))
        .with_grid_line_width(0.5)
}

/// All bands, then all lines, then their marks, so that no line is covered.
fn plots(panel: &Panel, bands: Bands) -> Vec<Plot> {
    let many = || panel.series.iter().filter(|series| has_bands(series));
    let confidence = many().map(|series| band(series, CONFIDENCE_OPACITY, |p| p.confidence));
    let with_range = many().filter(|_| bands == Bands::Both);
    let ranges = with_range.map(|series| band(series, RANGE_OPACITY, |p| p.quartiles));
    let bands = confidence.chain(ranges);
    let lines = panel.series.iter().map(line);
    bands.chain(lines).chain(panel.series.iter().map(marks)).collect()
}

fn band(series: &Series, opacity: f64, of: fn(&Point) -> Interval) -> Plot {
    let steps = series.points.iter().map(|point| point.env_steps);
    let (low, high) = (|point| of(point).low, |point| of(point).high);
    let band = BandPlot::new(steps, series.points.iter().map(low), series.points.iter().map(high));
    Plot::Band(band.with_color(colour(series.rank)).with_opacity(opacity))
}

fn line(series: &Series) -> Plot {
    let points = series.points.iter().map(|point| (point.env_steps, point.centre));
    let line = LinePlot::new().with_data(points).with_color(colour(series.rank));
    Plot::Line(line.with_stroke_width(STROKE).with_line_style(line_style(series.rank)))
}

/// Marks on the curve. Curves begin theirs at different points.
fn marks(series: &Series) -> Plot {
    let every = series.points.len().div_ceil(MARKS).max(1);
    let points = series.points.iter().skip(series.rank % every).step_by(every);
    let marks = ScatterPlot::new()
        .with_data(points.map(|point| (point.env_steps, point.centre)))
        .with_color(colour(series.rank))
        .with_size(MARK)
        .with_marker(marker(series.rank));
    Plot::Scatter(marks)
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
    use crate::figures::learning_curve::Quantity;

    fn rising(label: &str, rank: usize, runs: usize) -> Series {
        let point = |k: u32| {
            let centre = 2000.0 * f64::from(k) / f64::from(k + 3);
            let around = |low, high| Interval { low: centre - low, high: centre + high };
            let (confidence, quartiles) = (around(150.0, 120.0), around(80.0, 200.0));
            Point { env_steps: f64::from(k) * 100_000.0, centre, confidence, quartiles }
        };
        Series { label: label.into(), rank, runs, points: (0..=10).map(point).collect() }
    }

    fn panel(task: &str, quantity: Quantity) -> Panel {
        let series = vec![rising("happo (3 seeds)", 0, 3), rising("other (seed 1)", 1, 1)];
        Panel { task: task.into(), quantity, series }
    }

    #[test]
    fn both_forms_hold_the_curves_of_all_panels_with_one_legend_also_beside_an_empty_one() {
        let empty =
            || Panel { task: "empty".into(), quantity: Quantity::Information, series: vec![] };
        let panels = [panel("one", Quantity::Return), panel("two", Quantity::Surprise), empty()];
        let picture = draw(&panels, 2).unwrap();
        assert!(picture.svg.starts_with("<svg") && picture.png.starts_with(b"\x89PNG"));
        assert!(picture.svg.contains(&colour(0)) && picture.svg.contains(&colour(1)));
        assert_eq!(picture.svg.matches("happo (3 seeds)").count(), 1);
        for words in [">one<", ">two<", "evaluation return", "surprise, nats"] {
            assert!(picture.svg.contains(words), "{words}");
        }
        assert!(draw(&[empty()], 1).is_ok());
    }

    #[test]
    fn interquartile_ranges_are_drawn_among_few_curves_only() {
        let of = |curves: usize| {
            let series = (0..curves).map(|rank| rising(&format!("{rank}"), rank, 3)).collect();
            draw(&[Panel { task: "a task".into(), quantity: Quantity::Return, series }], 1).unwrap()
        };
        let (few, many) = (of(MOST_WITH_RANGES).svg, of(MOST_WITH_RANGES + 1).svg);
        assert!(few.contains("interquartile range") && !many.contains("interquartile range"));
        assert!(many.contains("95 % confidence interval"));
    }

    #[test]
    fn a_curve_whose_colour_another_has_is_dashed() {
        let series = [0, 8].map(|rank| rising(&rank.to_string(), rank, 1)).into();
        let panel = Panel { task: "a task".into(), quantity: Quantity::Return, series };
        let svg = draw(&[panel], 1).unwrap().svg;
        assert_eq!(colour(0), colour(8));
        assert_eq!(svg.matches(r#"stroke-dasharray="14 10""#).count(), 1);
    }

    #[test]
    fn env_steps_are_written_short() {
        assert_eq!(short_count(0.0), "0");
        assert_eq!(short_count(250_000.0), "250k");
        assert_eq!(short_count(1_000_000.0), "1M");
        assert_eq!(short_count(2_500_000.0), "2.5M");
    }
}
