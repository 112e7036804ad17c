//! `s2mia export`: a trained policy for other programs.

use std::path::PathBuf;

use clap::Args;

use crate::export;
use crate::process::output;
use crate::process::target::ForceArguments;
use crate::run::checkpointed;
use crate::run::offered::Stage;

/// `s2mia export`
#[derive(Args, Debug)]
pub(crate) struct ExportArguments {
    /// Run folder, or one of its checkpoints.
    pub(crate) run: PathBuf,
    /// Folder for agent_0.onnx, agent_1.onnx, ..., policy.safetensors and episode.safetensors.
    #[arg(long, value_name = "DIR")]
    pub(crate) onnx: PathBuf,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// Writes the files and prints what each contains.
pub(super) fn run(arguments: &ExportArguments) -> anyhow::Result<()> {
    let trained = checkpointed::trained(&arguments.run)?;
    let mut stage = Stage::of(&trained.config)?;
    output::option_folder("--onnx", &arguments.onnx)?;
    let existing = arguments.force.existing();
    let files = export::export((&arguments.onnx, existing), &trained, stage.environment.as_mut())?;
    for (name, holds) in files {
        output::line(format!("{}: {holds}", arguments.onnx.join(name).display()));
    }
    Ok(())
}
