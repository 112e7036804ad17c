//! `s2mia plot`: learning curves as SVG and PNG.

use std::path::PathBuf;

use crate::cli::PlotArguments;
use crate::figures::{self, learning_curve};
use crate::process::output;

/// Writes both files and prints their paths.
pub(super) fn run(arguments: &PlotArguments) -> anyhow::Result<()> {
    let curves = learning_curve::read_all(&arguments.runs)?;
    let folder = folder(arguments)?;
    let written = match arguments.ablation {
        true => figures::write_ablation(&folder, &curves)?,
        false => figures::write_learning_curve(&folder, &curves)?,
    };
    written.iter().for_each(|path| output::line(path.display()));
    Ok(())
}

fn folder(arguments: &PlotArguments) -> anyhow::Result<PathBuf> {
    Ok(match (&arguments.out, arguments.runs.as_slice()) {
        (Some(folder), _) => {
            output::option_folder("--out", folder)?;
            folder.clone()
        }
        (None, [only]) => only.clone(),
        (None, _) => PathBuf::from("."),
    })
}
