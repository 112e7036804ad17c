//! `s2mia log verify`: checks that logs are undamaged and complete.

use recording::trajectory_log::{read_bytes, read_shares};

use crate::cli::LogFiles;
use crate::commands::log::files::{in_file, paths, size, sizes};
use crate::errors::Incomplete;
use crate::figures::chart::thousands;
use crate::progress::WorkProgress;
use crate::run::run_path;

/// Ends with status 1 if a file is damaged, with 3 if only data is missing.
pub(super) fn run(logs: &LogFiles) -> anyhow::Result<()> {
    let paths = paths(logs)?;
    let (all, mut done, mut progress) = (sizes(&paths), 0, WorkProgress::new());
    let (mut cut_off, mut lost) = (0, 0);
    for path in &paths {
        let (mut shares, mut steps) = (0, 0);
        let bytes = in_file(path, read_bytes(path))?;
        let read = read_shares(&bytes, |share| {
            shares += 1;
            steps += share.steps.len() as u64;
            Ok(())
        });
        let log = in_file(path, read)?;
        cut_off += log.torn_steps;
        lost += log.lost_shares();
        done += size(path);
        progress.reach(done, all, || format!("read {}", run_path::name(path)));
        let (shown, shares, steps) = (path.display(), thousands(shares), thousands(steps));
        progress.print(format!(
            "{shown}: checksums and schemas are right: {shares} shares, {steps} steps; {} shares lost by the actor",
            thousands(log.lost_shares())
        ));
    }
    match (cut_off, lost) {
        (0, 0) => Ok(()),
        (cut_off, lost) => Err(Incomplete(format!(
            "{} steps of shares that were cut off, {} lost shares",
            thousands(cut_off),
            thousands(lost)
        ))
        .into()),
    }
}
