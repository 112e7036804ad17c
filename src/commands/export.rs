//! `s2mia export`: a trained policy for other programs.

use policy::RunSeed;

use crate::cli::ExportArguments;
use crate::commands::checkpointed;
use crate::{export, output};

/// Writes the files and says what is in each.
pub(super) fn run(arguments: &ExportArguments) -> anyhow::Result<()> {
    let trained = checkpointed::trained(&arguments.run)?;
    let seed = RunSeed(trained.config.run.seed);
    let about: Vec<_> = checkpointed::metadata(&trained).into_iter().collect();
    let of = (&trained.config.task, seed, trained.iteration);
    let files = export::export(&arguments.onnx, &trained.policy, of, &about)?;
    for (name, holds) in files {
        output::line(format!("{}: {holds}", arguments.onnx.join(name).display()));
    }
    Ok(())
}
