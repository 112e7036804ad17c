//! The arguments of the command for figures.

use std::path::PathBuf;

use clap::Args;

use super::ForceArguments;

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
