//! The looks of a series: colour, marks and dashes by its rank.

use kuva::plot::LineStyle;
use kuva::plot::scatter::MarkerShape;
use kuva::render::render::{Primitive, Scene};

use crate::figures::palette::{OKABE_ITO, Rgb, hex};

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

/// Mark of a rank. Past the colours each colour comes again, with another mark.
pub(super) fn marker(rank: usize) -> MarkerShape {
    MARKERS[(rank + 3 * (rank / COLOURS.len())) % MARKERS.len()]
}

/// Dashes of a rank: none for the first ranks, which differ in colour.
pub(super) fn line_style(rank: usize) -> LineStyle {
    match rank / COLOURS.len() {
        0 => LineStyle::Solid,
        1 => LineStyle::Dashed,
        _ => LineStyle::Dotted,
    }
}

/// Replaces dashed lines by their dashes. kuva's PNG begins the dashes anew at every point of a curve, so that a curve of
/// many points would be solid.
pub(super) fn cut_dashes(scene: &mut Scene) {
    let elements = std::mem::take(&mut scene.elements);
    for element in elements {
        match element {
            Primitive::PolyLine {
                points,
                stroke,
                stroke_width,
                stroke_dasharray: Some(pattern),
            } => {
                let lengths: Vec<f64> =
                    pattern.split_whitespace().filter_map(|length| length.parse().ok()).collect();
                for points in dashes(&points, &lengths) {
                    let stroke = stroke.clone();
                    let stroke_dasharray = None;
                    scene.add(Primitive::PolyLine {
                        points,
                        stroke,
                        stroke_width,
                        stroke_dasharray,
                    });
                }
            }
            other => scene.add(other),
        }
    }
}

/// The dashes along a line; `pattern` has the lengths of dash, gap, dash and so on.
fn dashes(points: &[(f64, f64)], pattern: &[f64]) -> Vec<Vec<(f64, f64)>> {
    let Some(&first) = points.first() else { return Vec::new() };
    let mut pieces = vec![vec![first]];
    let mut lengths = pattern.iter().copied().cycle();
    let (mut is_dash, mut left) = (true, lengths.next().unwrap_or(f64::INFINITY));
    for pair in points.windows(2) {
        let ((x, y), (to_x, to_y)) = (pair[0], pair[1]);
        let (right, down) = (to_x - x, to_y - y);
        let length = (right * right + down * down).sqrt();
        let mut done = 0.0;
        while length - done > left {
            done += left;
            let share = done / length;
            let point = (x + share * right, y + share * down);
            match is_dash {
                true => pieces.last_mut().expect("there is a first piece").push(point),
                false => pieces.push(vec![point]),
            }
            is_dash = !is_dash;
            left = lengths.next().unwrap_or(f64::INFINITY);
        }
        left -= length - done;
        if is_dash {
            pieces.last_mut().expect("there is a first piece").push((to_x, to_y));
        }
    }
    pieces.retain(|piece| piece.len() > 1);
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_many_points_has_the_same_dashes_as_one_of_two() {
        let few = [(0.0, 0.0), (30.0, 0.0)];
        let many: Vec<(f64, f64)> = (0..=60).map(|k| (f64::from(k) / 2.0, 0.0)).collect();
        let ends = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
            let ends = |piece: &Vec<(f64, f64)>| (piece[0].0, piece[piece.len() - 1].0);
            dashes(points, &[8.0, 4.0]).iter().map(ends).collect()
        };
        assert_eq!(ends(&few), [(0.0, 8.0), (12.0, 20.0), (24.0, 30.0)]);
        assert_eq!(ends(&many), ends(&few));
    }

    #[test]
    fn twenty_four_ranks_look_different() {
        let looks = |rank: usize| (colour(rank), line_style(rank).dasharray());
        for rank in 0..24 {
            assert!((0..rank).all(|other| looks(other) != looks(rank)), "{rank}");
            assert!((rank % 8 == rank) || marker(rank) != marker(rank % 8), "{rank}");
        }
    }
}
