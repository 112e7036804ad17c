//! The arguments of what a researcher does after training: figures, tables, experiments.

use std::path::PathBuf;

use clap::Args;

/// `s2mia plot`
#[derive(Args, Debug)]
pub(crate) struct PlotArguments {
    /// Run folders; runs that differ in nothing but their seed are drawn as one curve, with its 95 % confidence
    /// interval and interquartile range.
    #[arg(required = true, value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// Draw surprise and information below the returns, as ablation.svg and .png.
    #[arg(long)]
    pub(crate) ablation: bool,
    /// Folder for learning_curve.svg and .png [default: the run folder; for several runs this folder].
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// `s2mia experiment`
#[derive(Args, Debug)]
pub(crate) struct ExperimentArguments {
    /// TOML file: tasks x variants x seeds.
    pub(crate) file: PathBuf,
    /// Only list the runs, and how far each is.
    #[arg(long, conflicts_with = "report")]
    pub(crate) list: bool,
    /// Only make tables and figures from the runs that are there.
    #[arg(long)]
    pub(crate) report: bool,
    /// Runs at once [default: as many as the cores hold].
    #[arg(long, value_name = "RUNS", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) jobs: Option<u16>,
}
