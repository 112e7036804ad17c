//! The arguments of `s2mia export`.

use std::path::PathBuf;

use clap::Args;

/// `s2mia export`
#[derive(Args, Debug)]
pub(crate) struct ExportArguments {
    /// Run folder.
    pub(crate) run: PathBuf,
    /// Folder for agent_0.onnx, agent_1.onnx, ..., policy.safetensors and episode.safetensors.
    #[arg(long, value_name = "DIR")]
    pub(crate) onnx: PathBuf,
}
