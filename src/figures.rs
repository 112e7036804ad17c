//! Pictures of learning curves as files: one panel per task, or the ablation with its terms below.

pub(crate) mod chart;
pub(crate) mod learning_curve;
pub(crate) mod picture;
pub(crate) mod statistics;
pub(crate) mod style;

use std::path::{Path, PathBuf};

use crate::figures::learning_curve::{Curve, Panel, Quantity, panels};
use crate::process::target;

/// Panels in a row of a picture with many tasks.
const MOST_COLUMNS: usize = 3;

/// Name of the picture of the returns.
pub(crate) const LEARNING_CURVE: &str = "learning_curve";
/// Name of the picture of returns and terms.
pub(crate) const ABLATION: &str = "ablation";
const ENDINGS: [&str; 2] = ["svg", "png"];

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
    let picture = picture::draw(panels, columns)?;
    let contents = [picture.svg.into_bytes(), picture.png];
    let written = paths.into_iter().zip(contents).map(|(path, bytes)| {
        target::file(&path, &bytes)?;
        Ok(path)
    });
    written.collect()
}
