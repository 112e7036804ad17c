//! `s2mia status`: the state of a run, from its learner or, if none is running, from its newest checkpoint.

use std::path::Path;

use proto::{LeaseStatus, LeasedWork, RunEnd, RunLine, Status};
use serde_json::json;

use crate::cli::StatusArguments;
use crate::cli::patience;
use crate::commands::control::{operator, url};
use crate::config::run_settings::config_of_run;
use crate::figures::chart::thousands;
use crate::process::{output, runtime, shell};
use crate::run::checkpointed;
use crate::run::run_path;

/// Prints one line and a table of leases, or one JSON object.
pub(super) fn run(arguments: &StatusArguments) -> anyhow::Result<()> {
    let patience = patience(arguments.timeout_secs)?;
    let Some(url) = url(&arguments.learner)? else { return at_rest(arguments) };
    let status = runtime()?.block_on(async {
        let mut operator = operator(&url, &arguments.learner, patience).await?;
        anyhow::Ok(operator.status().await?)
    })?;
    match arguments.json {
        true => output::line(learner::exchange::status_json(&status)),
        false => output::line(text(&status)),
    }
    Ok(())
}

/// A run without a learner process: finished, stopped or crashed.
pub(super) struct AtRest {
    run_id: String,
    /// The newest checkpoint, if there is one.
    newest: Option<Reached>,
    iterations: u64,
}

/// How far a checkpoint is.
#[derive(Clone, Copy, Default)]
struct Reached {
    iteration: u64,
    env_steps: u64,
}

impl AtRest {
    /// Reads the newest checkpoint and the settings of the run in this folder.
    pub(super) fn of(run: &Path) -> anyhow::Result<Self> {
        let loaded = checkpointed::load_if_any(run)?;
        let newest = loaded.map(|loaded| Reached {
            iteration: loaded.checkpoint.iteration,
            env_steps: loaded.checkpoint.env_steps,
        });
        let (run_id, iterations) = (run_path::name(run), config_of_run(run)?.iterations());
        Ok(Self { run_id, newest, iterations })
    }

    /// The last line of the run.
    pub(super) fn last_line(&self) -> RunLine {
        let Reached { iteration, env_steps } = self.newest.unwrap_or_default();
        let line = RunLine::without_figures(self.run_id.clone(), iteration, env_steps);
        let end = if self.is_finished() { RunEnd::Finished } else { RunEnd::Stopped };
        RunLine { end: Some(end), ..line }
    }

    /// Whether the run has had its last iteration.
    pub(super) fn is_finished(&self) -> bool {
        self.newest.is_some_and(|newest| newest.iteration >= self.iterations)
    }
}

fn at_rest(arguments: &StatusArguments) -> anyhow::Result<()> {
    let run = Path::new(&arguments.learner.of);
    let rest = AtRest::of(run)?;
    let (iterations, newest) = (rest.iterations, rest.newest.unwrap_or_default());
    let Reached { iteration, env_steps } = newest;
    let state = if rest.is_finished() { "finished" } else { "stopped" };
    if arguments.json {
        let object = json!({
            "state": state,
            "iteration": iteration,
            "iterations": iterations,
            "env_steps": env_steps,
        });
        output::line(object);
        return Ok(());
    }
    let (shown, run, steps) = (run.display(), shell::path(run), thousands(env_steps));
    let at = format!("iteration {iteration} of {iterations}, {steps} env steps");
    output::line(match (rest.newest, rest.is_finished()) {
        (None, _) => format!(
            "{shown} stopped before its first checkpoint; `s2mia train --resume {run}` begins it again"
        ),
        (Some(_), true) => format!("{shown} is finished: {at}"),
        (Some(_), false) => {
            format!("{shown} is stopped: {at}; `s2mia train --resume {run}` goes on")
        }
    });
    Ok(())
}

fn text(status: &Status) -> String {
    let Status { run_id, iteration, slots, complete_slots, actors, leases, .. } = status;
    let pace = status.env_steps_per_sec.map_or_else(String::new, |pace| {
        format!(", {} env steps/s", thousands(pace.round() as u64))
    });
    let disk =
        if status.storage_degraded { "\nthe last checkpoint could not be written" } else { "" };
    let idle = match actors.saturating_sub(*slots) {
        0 => String::new(),
        idle => format!(" ({idle} more than slots in this iteration)"),
    };
    let mut text = format!(
        "{run_id}: iteration {iteration}, {} env steps{pace}\n\
         {complete_slots} of {slots} slots complete, {} leases on {actors} actors{idle}, \
         {} leased again, {} backed up, {} audited, {} messages refused{disk}",
        thousands(status.env_steps),
        leases.len(),
        status.leases_reissued,
        status.slots_backed_up,
        status.audits_agreed,
        status.messages_refused,
    );
    leases.iter().for_each(|lease| text += &format!("\n{}", line(lease)));
    text
}

fn line(lease: &LeaseStatus) -> String {
    let work = match lease.work {
        LeasedWork::Slot(slot) => format!("slot {slot}"),
        LeasedWork::Episode(episode) => format!("episode {episode}"),
    };
    let (chunks, still) = (lease.chunks, lease.still_secs);
    format!("  {work}: actor {}, {chunks} chunks, {still:.1} s since the last", lease.actor)
}
