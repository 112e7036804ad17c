//! `s2mia log recover`: copies the undamaged part of a log into a new file.

use recording::trajectory_log::{read_bytes, recover};

use crate::cli::RecoverArguments;
use crate::commands::log::files::in_file;
use crate::errors::Incomplete;
use crate::figures::chart::thousands;
use crate::process::output;
use crate::process::target::Target;

/// Ends with status 3 and a list of losses if data was lost.
pub(super) fn run(arguments: &RecoverArguments) -> anyhow::Result<()> {
    let RecoverArguments { file, out, force } = arguments;
    let target = Target::named("--out", out, "mcap", force.existing())?;
    let bytes = in_file(file, read_bytes(file))?;
    let recovered = target.fill(|draft| in_file(out, recover(&bytes, draft)))?;
    let (messages, shown) = (thousands(recovered.messages), out.display());
    output::line(format!("{shown}: {messages} messages"));
    let losses: Vec<String> = recovered.losses.iter().map(|loss| format!("lost: {loss}")).collect();
    match losses.is_empty() {
        true => Ok(()),
        false => Err(Incomplete(losses.join("; ")).into()),
    }
}
