//! Curves drawn with characters, for the terminal.

/// Heights of one character cell, in eighths.
const BLOCKS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// A filled curve of `(x, y)` with `y` on the left and the first and last `x` below; `rows` characters high.
pub(crate) fn area(points: &[(f64, f64)], width: usize, rows: usize, x_label: &str) -> String {
    let columns = resampled(points, width);
    let (low, high) = range(points);
    let heights: Vec<usize> =
        columns.iter().map(|&y| 1 + eighths(y, low, high, rows * 8 - 1)).collect();
    let labels: Vec<String> = (0..rows).map(|row| row_label(row, rows, low, high)).collect();
    let margin = labels.iter().map(|label| label.chars().count()).max().unwrap_or(0);
    let mut lines = Vec::new();
    for (row, label) in labels.iter().enumerate() {
        let floor = (rows - 1 - row) * 8;
        let cells: String =
            heights.iter().map(|h| BLOCKS[h.saturating_sub(floor).min(8)]).collect();
        lines.push(format!("  {label:>margin$} ┤{}", cells.trim_end()));
    }
    lines.push(format!("  {:margin$} └{}", "", "─".repeat(columns.len())));
    lines.push(format!("  {:margin$}  {}", "", x_axis(points, columns.len(), x_label)));
    lines.join("\n")
}

/// Labels at the top and the bottom of the y-axis.
fn row_label(row: usize, rows: usize, low: f64, high: f64) -> String {
    match row {
        0 => format!("{high:.1}"),
        row if row + 1 == rows => format!("{low:.1}"),
        _ => String::new(),
    }
}

fn x_axis(points: &[(f64, f64)], width: usize, label: &str) -> String {
    let first = points.first().map_or(0.0, |point| point.0);
    let last = points.last().map_or(0.0, |point| point.0);
    let left = thousands(first as u64);
    let right = format!("{} {label}", thousands(last as u64));
    let gap = width.saturating_sub(left.len() + right.len()).max(2);
    format!("{left}{}{right}", " ".repeat(gap))
}

/// `width` values over the x-range, joined by straight lines.
fn resampled(points: &[(f64, f64)], width: usize) -> Vec<f64> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let step = (last.0 - first.0) / (width.max(2) - 1) as f64;
    (0..width).map(|column| interpolated(points, first.0 + step * column as f64)).collect()
}

fn interpolated(points: &[(f64, f64)], x: f64) -> f64 {
    let after = points.partition_point(|point| point.0 < x);
    match (after.checked_sub(1).map(|before| points[before]), points.get(after)) {
        (Some(left), Some(right)) => {
            left.1 + (right.1 - left.1) * (x - left.0) / (right.0 - left.0)
        }
        (Some(only), None) => only.1,
        (None, Some(only)) => only.1,
        (None, None) => 0.0,
    }
}

/// Position of `value` in `low..=high`, from 0 to `steps`; the middle where the range is a point.
fn eighths(value: f64, low: f64, high: f64, steps: usize) -> usize {
    if high <= low {
        return steps / 2;
    }
    (((value - low) / (high - low)) * steps as f64).round().clamp(0.0, steps as f64) as usize
}

/// Lowest and highest `y`.
fn range(points: &[(f64, f64)]) -> (f64, f64) {
    let widened = |(low, high): (f64, f64), &(_, y): &(f64, f64)| (low.min(y), high.max(y));
    points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), widened)
}

/// A count with commas: `1,000,000`.
pub(crate) fn thousands(count: u64) -> String {
    indicatif::HumanCount(count).to_string()
}

/// A count with its noun: `1 actor`, `1,000 actors`.
pub(crate) fn count_of(count: u64, noun: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{} {noun}{ending}", thousands(count))
}

/// Seconds as people say them: `42s`, `3m07s`, `2h05m`.
pub(crate) fn duration(secs: f64) -> String {
    let secs = secs.max(0.0).round() as u64;
    match secs {
        0..60 => format!("{secs}s"),
        60..3600 => format!("{}m{:02}s", secs / 60, secs % 60),
        _ => format!("{}h{:02}m", secs / 3600, secs % 3600 / 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rising_curve_fills_the_lower_right_corner() {
        let chart = area(&[(0.0, 0.0), (1000.0, 10.0)], 16, 2, "env steps");
        let expected = "  10.0 ┤        ▁▂▃▄▅▆▇█\n   0.0 ┤▁▂▃▄▅▆▇█████████\n       └────────────────\n        0  1,000 env steps";
        assert_eq!(chart, expected);
    }

    #[test]
    fn the_labels_are_the_extremes_of_the_points_even_between_two_columns() {
        let chart = area(&[(0.0, 0.0), (7.0, 99.0), (14.0, 0.0), (1000.0, 10.0)], 11, 2, "steps");
        assert!(chart.starts_with("  99.0 ┤") && chart.contains("   0.0 ┤"), "{chart}");
    }

    #[test]
    fn a_single_point_is_a_flat_curve() {
        assert!(area(&[(5.0, 1.0)], 10, 3, "env steps").contains("1.0"));
    }

    #[test]
    fn counts_and_durations_read_well() {
        assert_eq!(thousands(0), "0");
        assert_eq!(thousands(999), "999");
        assert_eq!(thousands(1_000_000), "1,000,000");
        let counts = [0, 1, 1_000].map(|count| count_of(count, "lost share"));
        assert_eq!(counts, ["0 lost shares", "1 lost share", "1,000 lost shares"]);
        assert_eq!(duration(42.4), "42s");
        assert_eq!(duration(187.0), "3m07s");
        assert_eq!(duration(7500.0), "2h05m");
    }
}
