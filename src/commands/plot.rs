//! `s2mia plot`: learning curves as SVG and PNG.

use std::path::{Path, PathBuf};

use clap::Args;
use learner::store::run_folder::RunFolder;

use crate::figures::learning_curve::Curve;
use crate::figures::{self, learning_curve};
use crate::process::target::ForceArguments;
use crate::process::{output, target};

/// `s2mia plot`
#[derive(Args, Debug)]
pub(crate) struct PlotArguments {
    /// Run folders. Runs that differ only in their seed are drawn as one curve, with a 95 % confidence interval and
    /// an interquartile range.
    #[arg(required = true, value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// Draw surprise and information below the returns, as ablation.svg and .png.
    #[arg(long)]
    pub(crate) ablation: bool,
    /// Folder for learning_curve.svg and .png [default: the run folder; with several runs the current folder].
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// Writes both files and prints their paths.
pub(super) fn run(arguments: &PlotArguments) -> anyhow::Result<()> {
    let curves = learning_curve::read_all(&arguments.runs)?;
    learning_curve::shortened(&curves).iter().for_each(|line| tracing::warn!("{line}"));
    let folder = folder(arguments)?;
    let (name, write): (_, fn(&Path, &[Curve]) -> _) = if arguments.ablation {
        (figures::ABLATION, figures::write_ablation)
    } else {
        (figures::LEARNING_CURVE, figures::write_learning_curve)
    };
    target::demand_free("--out", figures::paths(&folder, name), arguments.force.existing())?;
    let written = write(&folder, &curves)?;
    written.iter().for_each(|path| output::line(path.display()));
    Ok(())
}

fn folder(arguments: &PlotArguments) -> anyhow::Result<PathBuf> {
    Ok(match (&arguments.out, arguments.runs.as_slice()) {
        (Some(folder), _) => {
            target::option_folder("--out", folder)?;
            folder.clone()
        }
        (None, [only]) => RunFolder::of(only),
        (None, _) => PathBuf::from("."),
    })
}
