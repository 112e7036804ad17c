//! What is asked of a learner at work: `s2mia pause`, `resume`, `checkpoint` and `stop`, and how it is found.

use std::path::Path;
use std::time::Duration;

use learner::run_folder::RunFolder;
use learner::service::Operator;

use crate::cli::{CheckpointArguments, LearnerArgument, OrderArguments};
use crate::cli::{credentials, patience};
use crate::errors::Usage;
use crate::process::{output, runtime};

/// Hands out no more work.
pub(super) fn pause(arguments: &OrderArguments) -> anyhow::Result<()> {
    order(&arguments.learner, arguments.timeout_secs, async |learner| {
        let leases = learner.pause().await?;
        let of = &arguments.learner.of;
        Ok(format!(
            "{of} is paused; {leases} leases go on to their end; `s2mia resume {of}` goes on"
        ))
    })
}

/// Hands out work again.
pub(super) fn resume(arguments: &OrderArguments) -> anyhow::Result<()> {
    order(&arguments.learner, arguments.timeout_secs, async |learner| {
        learner.resume().await?;
        Ok(format!("{} goes on", arguments.learner.of))
    })
}

/// Has a checkpoint written.
pub(super) fn checkpoint(arguments: &CheckpointArguments) -> anyhow::Result<()> {
    order(&arguments.learner, arguments.timeout_secs, async |learner| {
        let saved = learner.save_checkpoint().await?;
        Ok(format!("iteration {}: {}", saved.iteration, saved.path))
    })
}

/// Ends the learner.
pub(super) fn stop(arguments: &OrderArguments) -> anyhow::Result<()> {
    order(&arguments.learner, arguments.timeout_secs, async |learner| {
        learner.stop().await?;
        Ok(format!("{} stops after a checkpoint", arguments.learner.of))
    })
}

/// Gives one order, and says what came of it.
fn order(
    learner: &LearnerArgument,
    timeout_secs: f64,
    give: impl AsyncFnOnce(&mut Operator) -> anyhow::Result<String>,
) -> anyhow::Result<()> {
    let patience = patience(timeout_secs)?;
    let Some(url) = url(learner)? else {
        let of = &learner.of;
        anyhow::bail!("no learner works on {of}; `s2mia status {of}` says how far it came");
    };
    let told = runtime()?.block_on(async {
        let mut operator = operator(&url, learner, patience).await?;
        give(&mut operator).await
    });
    output::line(told?);
    Ok(())
}

/// Where the learner listens; `None` for the folder of a run on which none works.
pub(super) fn url(learner: &LearnerArgument) -> anyhow::Result<Option<String>> {
    let of = &learner.of;
    if of.contains("://") {
        return Ok(Some(of.clone()));
    }
    if !Path::new(of).is_dir() {
        return Err(Usage::new(format!("{of} is neither a run folder nor a URL")).into());
    }
    let scheme = if learner.tls.files().is_some() { "https" } else { "http" };
    let address = RunFolder::listening(Path::new(of))?;
    Ok(address.map(|address| format!("{scheme}://{address}")))
}

/// A connection to the learner at `url`.
pub(super) async fn operator(
    url: &str,
    learner: &LearnerArgument,
    patience: Duration,
) -> anyhow::Result<Operator> {
    let tls = credentials(url, &learner.tls)?;
    Ok(Operator::connect(url, tls.as_ref(), patience).await?)
}
