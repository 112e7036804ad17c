//! `s2mia export`: a trained policy for other programs.

use crate::cli::ExportArguments;
use crate::export;
use crate::process::output;
use crate::run::checkpointed;
use crate::run::offered::Stage;

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
