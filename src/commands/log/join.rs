//! `s2mia log join`: whole episodes from the shares of several actors.

use recording::trajectory_log::join;

use crate::cli::JoinArguments;
use crate::commands::log::files::{in_file, index, paid};
use crate::errors::Incomplete;
use crate::figures::chart::thousands;
use crate::process::output;
use crate::process::target::Target;
use crate::progress::WorkProgress;

/// Writes the file and prints its contents. Ends with status 3 if part of a reward log is damaged.
pub(super) fn run(arguments: &JoinArguments) -> anyhow::Result<()> {
    let target = Target::named("--out", &arguments.out, "mcap", arguments.force.existing())?;
    let mut progress = WorkProgress::new();
    let index = index(&arguments.logs, &mut progress)?;
    progress.begin_phase();
    let joined = target.fill(|draft| {
        let joined = join(&index, draft, |share, shares| {
            let place = || format!("wrote share {} of {}", thousands(share), thousands(shares));
            progress.reach(share, shares, place);
        });
        in_file(&arguments.out, joined)
    });
    drop(progress);
    let joined = joined?;
    let [episodes, shares, steps] =
        [joined.episodes as u64, joined.shares, joined.steps].map(thousands);
    let shown = arguments.out.display();
    let paid = paid(&index);
    output::line(format!("{shown}: {episodes} episodes, {shares} shares, {steps} steps; {paid}"));
    let gaps = index.gaps().len();
    if gaps > 0 {
        output::line(format!("{gaps} gaps in them; `s2mia log verify` lists them"));
    }
    index.remarks().iter().for_each(output::line);
    match index.damaged() {
        [] => Ok(()),
        damaged => Err(Incomplete(format!("skipped: {}", damaged.join("; "))).into()),
    }
}
