//! `s2mia log join`: whole episodes from the shares of several actors.

use actor::trajectory_log::join;

use crate::chart::thousands;
use crate::cli::JoinArguments;
use crate::commands::log::{in_file, index};
use crate::output;

/// Writes the file and says what is in it.
pub(super) fn run(arguments: &JoinArguments) -> anyhow::Result<()> {
    let index = index(&arguments.logs)?;
    let joined = in_file(&arguments.out, join(&index, &arguments.out))?;
    let [episodes, shares, steps] =
        [joined.episodes as u64, joined.shares, joined.steps].map(thousands);
    let shown = arguments.out.display();
    let paid = thousands(index.paid() as u64);
    output::line(format!(
        "{shown}: {episodes} episodes, {shares} shares, {steps} steps; intrinsic rewards of {paid} shares"
    ));
    let gaps = index.gaps().len();
    if gaps > 0 {
        output::line(format!("{gaps} gaps in them; `s2mia log verify` lists them"));
    }
    Ok(())
}
