//! `s2mia log verify`: whether logs are sound and whole.

use actor::trajectory_log::Index;

use crate::chart::thousands;
use crate::cli::LogFiles;
use crate::commands::log::{Incomplete, index};
use crate::output;

/// Ends with status 1 if a file is damaged or shares contradict each other, with 3 if only something is missing.
pub(super) fn run(logs: &LogFiles) -> anyhow::Result<()> {
    let index = index(logs)?;
    output::line(told(&index));
    let contradictions = index.contradictions();
    contradictions.iter().for_each(output::line);
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
    let [paid, copies, lost] = [index.paid() as u64, index.copies(), index.lost().0].map(thousands);
    format!(
        "checksums and schemas are right: {episodes} episodes, {shares} shares, {steps} steps; intrinsic rewards of \
         {paid} shares; {copies} shares computed again, alike; {lost} shares lost by their actors"
    )
}
