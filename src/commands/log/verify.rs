//! `s2mia log verify`: checks that logs are undamaged and complete.

use recording::trajectory_log::Index;

use crate::cli::LogFiles;
use crate::commands::log::files::{index, paid};
use crate::errors::Incomplete;
use crate::figures::chart::thousands;
use crate::process::output;
use crate::progress::WorkProgress;

/// Ends with status 1 if a file is damaged or shares contradict each other, with 3 if only data is missing.
pub(super) fn run(logs: &LogFiles) -> anyhow::Result<()> {
    let index = index(logs, &mut WorkProgress::new())?;
    let damaged = index.damaged();
    damaged.iter().for_each(output::line);
    anyhow::ensure!(damaged.is_empty(), "{} damaged reward logs", damaged.len());
    output::line(told(&index));
    let contradictions = index.contradictions();
    index.remarks().iter().chain(&contradictions).for_each(output::line);
    anyhow::ensure!(contradictions.is_empty(), "{} contradictions", contradictions.len());
    let gaps = index.gaps();
    gaps.iter().for_each(|gap| output::line(format!("missing: {gap}")));
    match (gaps.len(), index.torn_steps()) {
        (0, 0) => Ok(()),
        (gaps, torn) => Err(Incomplete(format!(
            "{gaps} gaps in episodes and {} steps of shares that were cut off; give the logs of all actors",
            thousands(torn)
        ))
        .into()),
    }
}

fn told(index: &Index) -> String {
    let (shares, steps) = index.shares_and_steps();
    let [episodes, shares, steps] = [index.episodes() as u64, shares, steps].map(thousands);
    let (copies, lost) = (thousands(index.copies()), thousands(index.lost().0));
    format!(
        "checksums and schemas are right: {episodes} episodes, {shares} shares, {steps} steps; {}; {copies} shares \
         computed again, alike; {lost} shares lost by their actors",
        paid(index)
    )
}
