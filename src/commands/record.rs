//! `s2mia record`: episodes of a trained policy as MCAP.

use std::path::PathBuf;

use anyhow::Context as _;
use policy::RunSeed;

use crate::cli::RecordArguments;
use crate::figures::chart;
use crate::process::output;
use crate::run::checkpointed;
use crate::run::offered::Stage;
use crate::run::run_path;

/// Writes the file and prints its contents.
pub(super) fn run(arguments: &RecordArguments) -> anyhow::Result<()> {
    let trained = checkpointed::trained(&arguments.run)?;
    let path = path(arguments, trained.iteration);
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        output::folder(folder)?;
    }
    let seed = RunSeed(trained.config.run.seed);
    let mut stage = Stage::of(&trained.config)?;
    let name = stage.environment.description().task.clone();
    let task = trained.config.environment.url.is_empty().then_some(&trained.config.task);
    let summary = actor::record(
        (stage.environment.as_mut(), task),
        &trained.policy,
        seed,
        arguments.episodes,
        &path,
        &checkpointed::metadata(&trained, &name),
    )
    .with_context(|| format!("cannot record {}", path.display()))?;
    for (index, episode) in summary.episodes.iter().enumerate() {
        let (value, steps) = (episode.extrinsic_return, episode.steps);
        output::line(format!("episode {index}: return {value:.2}, {steps} steps"));
    }
    let megabytes = summary.bytes as f64 / 1e6;
    let (messages, shown) = (chart::thousands(summary.messages), path.display());
    output::line(format!("{shown}: {messages} messages, {megabytes:.1} MB; open it in Foxglove"));
    Ok(())
}

fn path(arguments: &RecordArguments, iteration: u64) -> PathBuf {
    let named = || run_path::logs(&arguments.run).join(format!("iter_{iteration:08}.mcap"));
    arguments.out.clone().unwrap_or_else(named)
}
