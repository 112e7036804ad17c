//! `s2mia plot`: learning curves as SVG and PNG.

use std::path::{Path, PathBuf};

use learner::run_folder::RunFolder;

use crate::cli::PlotArguments;
use crate::figures::learning_curve::Curve;
use crate::figures::{self, learning_curve};
use crate::process::{output, target};

/// Writes both files and prints their paths.
pub(super) fn run(arguments: &PlotArguments) -> anyhow::Result<()> {
    let curves = learning_curve::read_all(&arguments.runs)?;
    let folder = folder(arguments)?;
    let (name, write): (_, fn(&Path, &[Curve]) -> _) = match arguments.ablation {
        true => (figures::ABLATION, figures::write_ablation),
        false => (figures::LEARNING_CURVE, figures::write_learning_curve),
    };
    // A run folder has the figures of its own run only.
    if arguments.out.is_some() || arguments.runs.len() > 1 {
        target::demand_free("--out", figures::paths(&folder, name), arguments.force.existing())?;
    }
    let written = write(&folder, &curves)?;
    written.iter().for_each(|path| output::line(path.display()));
    Ok(())
}

fn folder(arguments: &PlotArguments) -> anyhow::Result<PathBuf> {
    Ok(match (&arguments.out, arguments.runs.as_slice()) {
        (Some(folder), _) => {
            output::option_folder("--out", folder)?;
            folder.clone()
        }
        (None, [only]) => RunFolder::of(only),
        (None, _) => PathBuf::from("."),
    })
}
