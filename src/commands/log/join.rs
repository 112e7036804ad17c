//! `s2mia log join`: whole episodes from the shares of several actors.

use actor::trajectory_log::{Index, join};

use crate::chart::thousands;
use crate::cli::JoinArguments;
use crate::commands::log::{in_file, paths};
use crate::output;

/// Writes the file and says what is in it.
pub(super) fn run(arguments: &JoinArguments) -> anyhow::Result<()> {
    let mut index = Index::default();
    for path in paths(&arguments.logs)? {
        in_file(&path, index.add(&path))?;
    }
    let joined = in_file(&arguments.out, join(&index, &arguments.out))?;
    let [episodes, shares, steps] =
        [joined.episodes as u64, joined.shares, joined.steps].map(thousands);
    let shown = arguments.out.display();
    output::line(format!("{shown}: {episodes} episodes, {shares} shares, {steps} steps"));
    let gaps = index.gaps().len();
    if gaps > 0 {
        output::line(format!("{gaps} gaps in them; `s2mia log verify` lists them"));
    }
    Ok(())
}
