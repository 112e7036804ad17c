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
    let about = checkpointed::metadata(&trained, &stage.environment.description().task);
    let world = stage.environment.as_mut();
    let files = export::export(&arguments.onnx, &trained.policy, world, trained.start(0), &about)?;
    for (name, holds) in files {
        output::line(format!("{}: {holds}", arguments.onnx.join(name).display()));
    }
    Ok(())
}
