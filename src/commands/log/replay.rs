//! `s2mia log replay`: checks that the simulator reproduces the logged steps.

use actor::trajectory_log::{read_bytes, replay};

use crate::cli::LogFiles;
use crate::commands::log::files::{in_file, paths};
use crate::figures::chart::thousands;
use crate::process::output;

/// Ends with status 1 at the first step that differs.
pub(super) fn run(logs: &LogFiles) -> anyhow::Result<()> {
    for path in paths(logs)? {
        let replayed = in_file(&path, read_bytes(&path).and_then(|bytes| replay(&bytes)))?;
        let (shown, shares) = (path.display(), thousands(replayed.shares));
        let steps = thousands(replayed.steps);
        output::line(format!("{shown}: {steps} steps in {shares} shares, equal bit for bit"));
        let Some(difference) = replayed.difference else { continue };
        match replayed.other_program {
            Some(_) => anyhow::bail!(
                "{shown}: {difference}; it was logged by a program that computes other numbers"
            ),
            None => anyhow::bail!("{shown}: {difference}"),
        }
    }
    Ok(())
}
