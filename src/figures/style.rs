//! The looks of a series, which its rank determines: colour, dashes and marks; and the legend that shows them.

use kuva::plot::LineStyle;
use kuva::plot::legend::{LegendEntry, LegendShape};
use kuva::plot::scatter::MarkerShape;
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

/// Marks on curves, which distinguish them where colours do not.
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
        // The ends of dashes are round in a PNG, and take four units of a gap.
        round => LineStyle::Custom(format!("{} 10", 14 * round)),
    }
}

/// Mark of a rank. A colour that comes again has another mark.
pub(super) fn marker(rank: usize) -> MarkerShape {
    MARKERS[(rank + 3 * (rank / COLOURS.len())) % MARKERS.len()]
}

/// Entries of the legend, each with the colour and mark of its series.
pub(super) fn legend(series: &[&Series]) -> Vec<LegendEntry> {
    let entry = |series: &&Series| LegendEntry {
        label: series.label.clone(),
        color: colour(series.rank),
        shape: LegendShape::Marker(marker(series.rank)),
        dasharray: None,
    };
    series.iter().map(entry).collect()
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
