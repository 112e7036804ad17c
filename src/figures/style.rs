//! The looks of a series, which its rank determines: colour, dashes and marks; and the legend that shows them.

use kuva::plot::LineStyle;
use kuva::plot::scatter::MarkerShape;
use kuva::render::color::Color;
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor};
use sim::OKABE_ITO;

use crate::figures::learning_curve::Series;

/// Red, green, blue.
pub(crate) type Rgb = [u8; 3];

/// `#0072b2`
pub(crate) fn hex([red, green, blue]: Rgb) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// Colours of thin lines on white: the palette's without its pale yellow and its second blue, and with brown and grey.
const COLOURS: [Rgb; 8] = {
    let [blue, vermilion, green, pink, orange, _, black, _] = OKABE_ITO;
    let (brown, grey) = ([0x6F, 0x41, 0x00], [0x88, 0x88, 0x88]);
    [blue, vermilion, green, brown, orange, pink, black, grey]
};

/// Marks on curves, which tell them apart where colours do not.
const MARKERS: [MarkerShape; 8] = [
    MarkerShape::Circle,
    MarkerShape::Square,
    MarkerShape::Triangle,
    MarkerShape::Diamond,
    MarkerShape::TriangleDown,
    MarkerShape::Cross,
    MarkerShape::Plus,
    MarkerShape::Star,
];

/// Width of a curve, SVG units.
pub(super) const STROKE: f64 = 2.0;
/// Half the width of a mark, SVG units.
pub(super) const MARK: f64 = 4.5;

/// Colour of a rank.
pub(super) fn colour(rank: usize) -> String {
    hex(COLOURS[rank % COLOURS.len()])
}

/// Dashes of a rank. Past the colours each colour comes again, with dashes, which are longer in every further round.
pub(super) fn line_style(rank: usize) -> LineStyle {
    match rank / COLOURS.len() {
        0 => LineStyle::Solid,
        round => LineStyle::Custom(format!("{} 3", 6 * round)),
    }
}

/// Mark of a rank. A colour that comes again has another mark.
pub(super) fn marker(rank: usize) -> MarkerShape {
    MARKERS[(rank + 3 * (rank / COLOURS.len())) % MARKERS.len()]
}

/// Length of the piece of a curve, with a mark on it. All lengths are in SVG units.
const PIECE: f64 = 52.0;
/// Distance between the piece and its label, and between columns.
const GAP: f64 = 10.0;
/// Height of a row.
const ROW: f64 = 20.0;
/// Space around the legend.
const MARGIN: f64 = 14.0;
/// Size of the letters, and about the width of one.
const LETTERS: u32 = 13;
const LETTER_WIDTH: f64 = 7.8;

/// Adds the legend of `series` below everything in the scene, in as many columns as fit.
pub(super) fn add_legend(scene: &mut Scene, series: &[&Series]) {
    let longest = series.iter().map(|series| series.label.chars().count()).max().unwrap_or(0);
    let column = PIECE + GAP + LETTER_WIDTH * longest as f64 + 2.0 * GAP;
    let fit = ((scene.width - 2.0 * MARGIN) / column).floor().max(1.0) as usize;
    // As many rows as needed, with equally many entries in each.
    let rows = series.len().div_ceil(fit).max(1);
    let columns = series.len().div_ceil(rows).max(1);
    let left = ((scene.width - columns as f64 * column) / 2.0).max(MARGIN);
    let top = scene.height;
    scene.height += rows as f64 * ROW + MARGIN;
    for (index, series) in series.iter().enumerate() {
        let x = left + (index / rows) as f64 * column;
        let y = top + (index % rows) as f64 * ROW;
        entry(scene, series, (x, y + ROW / 2.0));
    }
}

/// One entry; `(x, y)` is the left end of its piece.
fn entry(scene: &mut Scene, series: &Series, (x, y): (f64, f64)) {
    let colour = colour(series.rank);
    scene.add(Primitive::PolyLine {
        points: vec![(x, y), (x + PIECE, y)],
        stroke: colour.as_str().into(),
        stroke_width: STROKE,
        stroke_dasharray: line_style(series.rank).dasharray(),
    });
    mark(scene, marker(series.rank), &colour.as_str().into(), (x + PIECE / 2.0, y));
    scene.add(Primitive::Text {
        x: x + PIECE + GAP,
        y: y + 0.35 * f64::from(LETTERS),
        content: series.label.clone(),
        size: LETTERS,
        anchor: TextAnchor::Start,
        rotate: None,
        bold: false,
        color: None,
    });
}

/// A mark as kuva draws it on a curve.
fn mark(scene: &mut Scene, shape: MarkerShape, colour: &Color, (x, y): (f64, f64)) {
    let place = |(right, down): (f64, f64)| (x + MARK * right, y + MARK * down);
    let corners: Vec<(f64, f64)> = match shape {
        MarkerShape::Square => vec![(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)],
        MarkerShape::Triangle => vec![(0.0, -1.02), (1.0, 0.68), (-1.0, 0.68)],
        MarkerShape::TriangleDown => vec![(0.0, 1.02), (1.0, -0.68), (-1.0, -0.68)],
        MarkerShape::Diamond => vec![(0.0, -1.3), (1.3, 0.0), (0.0, 1.3), (-1.3, 0.0)],
        MarkerShape::Star => star().collect(),
        MarkerShape::Cross => {
            let ends = [(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)];
            return crossed(scene, colour, ends.map(place));
        }
        MarkerShape::Plus => {
            let ends = [(0.0, -0.9), (0.9, 0.0), (0.0, 0.9), (-0.9, 0.0)];
            return crossed(scene, colour, ends.map(place));
        }
        _ => return disc(scene, colour, (x, y)),
    };
    let corners = corners.into_iter().map(place).map(|(x, y)| format!("{x:.2},{y:.2}"));
    scene.add(Primitive::Path(Box::new(PathData {
        d: format!("M{} Z", corners.collect::<Vec<_>>().join(" L")),
        fill: Some(colour.clone()),
        stroke: colour.clone(),
        stroke_width: 0.5,
        opacity: None,
        stroke_dasharray: None,
    })));
}

/// Five points and the corners between them.
fn star() -> impl Iterator<Item = (f64, f64)> {
    // Sine and negated cosine of the multiples of 36 degrees.
    let ring = [(0.0, -1.0), (0.588, -0.809), (0.951, -0.309), (0.951, 0.309), (0.588, 0.809)];
    let other_half = ring.map(|(right, down)| (-right, -down));
    let sizes = [1.3, 0.55].into_iter().cycle();
    ring.into_iter().chain(other_half).zip(sizes).map(|((x, y), size)| (size * x, size * y))
}

fn disc(scene: &mut Scene, colour: &Color, (cx, cy): (f64, f64)) {
    scene.add(Primitive::Circle {
        cx,
        cy,
        r: MARK,
        fill: colour.clone(),
        fill_opacity: None,
        stroke: None,
        stroke_width: None,
    });
}

/// Two lines between opposite ones of four ends.
fn crossed(scene: &mut Scene, colour: &Color, ends: [(f64, f64); 4]) {
    for (from, to) in [(ends[0], ends[2]), (ends[1], ends[3])] {
        scene.add(Primitive::Line {
            x1: from.0,
            y1: from.1,
            x2: to.0,
            y2: to.1,
            stroke: colour.clone(),
            stroke_width: 1.5,
            stroke_dasharray: None,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_is_written_as_style_sheets_do() {
        assert_eq!(hex(OKABE_ITO[0]), "#0072b2");
    }

    #[test]
    fn every_rank_has_its_own_colour_and_dashes_and_the_first_sixty_four_their_own_colour_and_mark()
    {
        let dashed = |rank: usize| (colour(rank), line_style(rank).dasharray());
        let marked = |rank: usize| (colour(rank), marker(rank));
        for rank in 0..64 {
            let mut others = 0..rank;
            assert!(
                others.all(|o| dashed(o) != dashed(rank) && marked(o) != marked(rank)),
                "{rank}"
            );
        }
    }
}
