//! `s2mia log replay`: checks that the simulator reproduces the logged steps.

use std::path::Path;

use recording::trajectory_log::{Replayed, read_bytes, replay};

use crate::cli::LogFiles;
use crate::commands::log::files::{in_file, paths, size, sizes};
use crate::figures::chart::thousands;
use crate::progress::WorkProgress;
use crate::run::run_path;

/// Ends with status 1 at the first step that differs.
pub(super) fn run(logs: &LogFiles) -> anyhow::Result<()> {
    let paths = paths(logs)?;
    let (all, mut done, mut progress) = (sizes(&paths), 0, WorkProgress::new());
    for path in &paths {
        let replayed = replayed(path, (done, all), &mut progress)?;
        done += size(path);
        let (shown, shares) = (path.display(), thousands(replayed.shares));
        let steps = thousands(replayed.steps);
        progress.print(format!("{shown}: {steps} steps in {shares} shares, equal bit for bit"));
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

/// Replays a file, of whose logs' `all` bytes `done` are in earlier files.
fn replayed(
    path: &Path,
    (done, all): (u64, u64),
    progress: &mut WorkProgress,
) -> anyhow::Result<Replayed> {
    let bytes = in_file(path, read_bytes(path))?;
    let replayed = replay(&bytes, |step, steps| {
        let here = bytes.len() as f64 * step as f64 / steps.max(1) as f64;
        let name = run_path::name(path);
        let place = || format!("{name}, step {} of {}", thousands(step), thousands(steps));
        progress.reach(done + here as u64, all, place);
    });
    in_file(path, replayed)
}
