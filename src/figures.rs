//! Pictures of learning curves as files: one panel per task, or the ablation with its terms below.

pub(crate) mod chart;
pub(crate) mod learning_curve;
mod legend;
pub(crate) mod palette;
pub(crate) mod picture;
pub(crate) mod statistics;
mod style;

use std::path::{Path, PathBuf};

use crate::figures::learning_curve::{Curve, Panel, Quantity, panels};
use crate::process::output;

/// Panels in a row of a picture with many tasks.
const MOST_COLUMNS: usize = 3;

/// Writes `learning_curve.svg` and `.png`: the return on each task.
pub(crate) fn write_learning_curve(
    folder: &Path,
    curves: &[Curve],
) -> anyhow::Result<Vec<PathBuf>> {
    let panels = panels(curves, &[Quantity::Return]);
    let columns = panels.len().clamp(1, MOST_COLUMNS);
    write(folder, "learning_curve", &panels, columns)
}

/// Writes `ablation.svg` and `.png`: a column for each task; a row for each of return, surprise and information that
/// some run has.
pub(crate) fn write_ablation(folder: &Path, curves: &[Curve]) -> anyhow::Result<Vec<PathBuf>> {
    let measured = |quantity: &Quantity| curves.iter().any(|curve| !curve.of(*quantity).is_empty());
    let quantities: Vec<Quantity> = Quantity::ALL.into_iter().filter(measured).collect();
    let panels = panels(curves, &quantities);
    let columns = panels.len() / quantities.len().max(1);
    write(folder, "ablation", &panels, columns)
}

fn write(
    folder: &Path,
    name: &str,
    panels: &[Panel],
    columns: usize,
) -> anyhow::Result<Vec<PathBuf>> {
    let picture = picture::draw(panels, columns)?;
    let files = [("svg", picture.svg.into_bytes()), ("png", picture.png)];
    let written = files.map(|(ending, bytes)| {
        let path = folder.join(format!("{name}.{ending}"));
        output::file(&path, &bytes)?;
        Ok(path)
    });
    written.into_iter().collect()
}
