//! The arguments of the commands for figures, tables and experiments.

use std::path::PathBuf;

use clap::Args;

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
}

/// `s2mia experiment`
#[derive(Args, Debug)]
pub(crate) struct ExperimentArguments {
    /// TOML file with tasks, variants and seeds.
    pub(crate) file: PathBuf,
    /// Only list the runs and their progress.
    #[arg(long, conflicts_with = "report")]
    pub(crate) list: bool,
    /// Only make tables and figures from the existing runs.
    #[arg(long)]
    pub(crate) report: bool,
    /// Number of parallel runs [default: from the number of cores].
    #[arg(long, value_name = "RUNS", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) jobs: Option<u16>,
}
