//! `s2mia record`: episodes of a trained policy as MCAP.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use learner::store::run_folder::{LOGS, RunFolder};
use recording::{RecordError, RecordSummary, RecordedRun};
use rollout::EvaluationEpisode;

use crate::figures::chart;
use crate::process::output;
use crate::process::target::ForceArguments;
use crate::progress::WorkProgress;
use crate::run::chosen::{ChosenArguments, ProgramArguments};
use crate::run::offered::RunEnvironment;
use crate::run::stored::Trained;
use crate::run::{run_path, stored};

/// `s2mia record`
#[derive(Args, Debug)]
pub(crate) struct RecordArguments {
    /// Policies.
    #[command(flatten)]
    pub(crate) of: ChosenArguments,
    /// Environment.
    #[command(flatten)]
    pub(crate) program: ProgramArguments,
    /// Number of whole episodes to record, from episode 0 on.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) episodes: u32,
    /// Record only the episode with this index, counted as in `s2mia eval`.
    #[arg(long, value_name = "INDEX", conflicts_with = "episodes")]
    pub(crate) episode: Option<u32>,
    /// MCAP file to write [default: RUN/logs/iter_ITERATION.mcap or TASK.mcap].
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Force.
    #[command(flatten)]
    pub(crate) force: ForceArguments,
}

/// Writes the file and prints its contents.
pub(super) fn run(arguments: &RecordArguments) -> anyhow::Result<()> {
    let of = arguments.of.path()?;
    let trained = arguments.program.trained(&of)?;
    let out = ("--out", arguments.out.as_deref());
    let own = Path::new(LOGS).join(format!("iter_{:08}.mcap", trained.iteration));
    let target = run_path::target(&of, out, &own, arguments.force.existing())?;
    let mut hosted = trained.environment()?;
    let run = recorded(&of, &trained, &hosted)?;
    let episodes = episodes(arguments, &trained);
    let summary = target.fill(|draft| {
        played(&mut hosted, &run, &episodes, draft)
            .with_context(|| format!("cannot record {}", target.path().display()))
    })?;
    for (episode, played) in episodes.iter().zip(&summary.episodes) {
        let (value, steps) = (played.extrinsic_return, played.steps);
        output::line(format!("{episode}: return {value:.2}, {steps} steps"));
    }
    let megabytes = summary.bytes as f64 / 1e6;
    let messages = chart::thousands(summary.messages);
    let shown = target.path().display();
    output::line(format!("{shown}: {messages} messages, {megabytes:.1} MB; open it in Foxglove"));
    Ok(())
}

/// Plays the episodes one after the other and records them.
fn played(
    hosted: &mut RunEnvironment,
    run: &RecordedRun<'_>,
    episodes: &[EvaluationEpisode],
    path: &Path,
) -> Result<RecordSummary, RecordError> {
    let world = hosted.environment.as_mut();
    let most = u64::from(world.description().episode_steps);
    let count = episodes.len();
    let progress = WorkProgress::new();
    recording::record(world, run, episodes, path, |index, step| {
        let place = || format!("episode {}/{count}, step {step}", index + 1);
        progress.reach(index as u64 * most + u64::from(step), count as u64 * most, place);
    })
}

/// The chosen episode, or the first ones.
fn episodes(arguments: &RecordArguments, trained: &Trained) -> Vec<EvaluationEpisode> {
    let indices = match arguments.episode {
        Some(index) => index..=index,
        None => 0..=arguments.episodes - 1,
    };
    indices.map(|index| trained.episode(index)).collect()
}

fn recorded<'a>(
    of: &Path,
    trained: &'a Trained,
    hosted: &RunEnvironment,
) -> anyhow::Result<RecordedRun<'a>> {
    let config = &trained.config;
    let task = &hosted.environment.description().task;
    let mut metadata = stored::metadata(trained, task);
    metadata.insert("run_id".to_owned(), run_path::name(&RunFolder::of(of)));
    let task_settings = match config.environment.url.as_str() {
        "" => serde_json::to_string(&config.task).context("cannot write the task's settings")?,
        _ => String::new(),
    };
    let settings_toml = config.resolved.to_toml();
    let policy = &trained.policy;
    let weights = trained.weights;
    Ok(RecordedRun { policy, weights, metadata, settings_toml, task_settings })
}
