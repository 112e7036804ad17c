//! The arguments of `s2mia export`.

use std::path::PathBuf;

use clap::Args;

use super::ForceArguments;

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
