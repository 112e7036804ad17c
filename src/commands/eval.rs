//! `s2mia eval`: whole episodes of a trained policy, mean or drawn actions, extrinsic return only.

use anyhow::Context as _;
use clap::Args;
use learner::observe::event::Spread;
use learner::train::reward_terms::means_per_episode;
use proto::{ActionChoice, EnvironmentSpec};
use rollout::{Episode, StepEvent};
use serde_json::json;
use sim::{Disturbances, EnvironmentBatch};

use crate::errors::Usage;
use crate::figures::chart;
use crate::process::output;
use crate::progress::WorkProgress;
use crate::run::chosen::{ChosenArguments, ProgramArguments};
use crate::run::stored::Trained;

/// `s2mia eval`
#[derive(Args, Debug)]
pub(crate) struct EvalArguments {
    /// Policies.
    #[command(flatten)]
    pub(crate) of: ChosenArguments,
    /// Environment.
    #[command(flatten)]
    pub(crate) program: ProgramArguments,
    /// Number of whole episodes.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) episodes: u32,
    /// Sample actions as in training (seed of episode I: SEED + I) instead of using the mean or most probable action.
    #[arg(long, value_name = "SEED", num_args = 0..=1, default_missing_value = "0")]
    pub(crate) sampled: Option<u64>,
    /// Play the episodes twice: without and then with the disturbances of the task.
    #[arg(long)]
    pub(crate) disturbed: bool,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    pub(crate) json: bool,
}

/// The first states are those that the run's own evaluation of this iteration would use.
pub(super) fn run(arguments: &EvalArguments) -> anyhow::Result<()> {
    let run = arguments.of.path()?;
    let trained = arguments.program.trained(&run)?;
    let mut hosted = trained.environment()?;
    let world = hosted.environment.as_mut();
    if arguments.disturbed && !world.can_be_disturbed() {
        let why = "--disturbed: the task has no [disturbance] (docs/ADDING_A_TASK.md)";
        return Err(Usage::new(why.to_owned()).into());
    }
    if arguments.disturbed {
        world.set_disturbances(Disturbances::Off);
    }
    let plain = play(world, &trained, arguments)?;
    let disturbed = arguments.disturbed.then(|| {
        world.set_disturbances(Disturbances::AsInTraining);
        play(world, &trained, arguments)
    });
    let disturbed = disturbed.transpose()?;
    let task = hosted.environment.description();
    if arguments.json {
        let mut object = as_json(task, &trained, &plain, disturbed.as_deref());
        if let Some(seed) = arguments.sampled {
            object["sampled_seed"] = json!(seed);
        }
        output::line(object);
        return Ok(());
    }
    let simulator = if trained.config.environment.url.is_empty() { "rapier/" } else { "" };
    let run = run.display();
    let steps = chart::thousands(trained.env_steps);
    let seed = trained.config.run.seed;
    let first = trained.episode(0).id();
    let last = trained.episode(arguments.episodes - 1).id();
    output::line(format!("{run}: {simulator}{} after {steps} env steps", task.task));
    let sampled = arguments.sampled.map(|seed| format!(", actions sampled with seed {seed}"));
    let sampled = sampled.unwrap_or_default();
    output::line(format!("episodes {first} to {last}, seed {seed}{sampled}\n"));
    let terms = &task.reward_terms;
    match disturbed {
        None => output::line(as_table(terms, &plain)),
        Some(disturbed) => {
            output::line(format!("without disturbances\n{}\n", as_table(terms, &plain)));
            output::line(format!("with disturbances\n{}", as_table(terms, &disturbed)));
        }
    }
    Ok(())
}

/// Plays the episodes one after the other.
fn play(
    world: &mut dyn EnvironmentBatch,
    trained: &Trained,
    arguments: &EvalArguments,
) -> anyhow::Result<Vec<Episode>> {
    let most = u64::from(world.description().episode_steps);
    let count = arguments.episodes;
    let progress = WorkProgress::new();
    let episode = |episode: u32| {
        let choice = match arguments.sampled {
            Some(seed) => ActionChoice::Sampled { seed: seed.wrapping_add(episode.into()) },
            None => ActionChoice::Mean,
        };
        let start = (trained.episode(episode).key(), choice);
        let on_event = |event: StepEvent<'_>| {
            let StepEvent::After(step) = event else { return };
            let done = u64::from(episode) * most + u64::from(step.step);
            let place = || format!("episode {}/{count}, step {}", episode + 1, step.step);
            progress.reach(done, u64::from(count) * most, place);
        };
        rollout::play_episode(world, &trained.policy, start, on_event).context("the episode failed")
    };
    (0..arguments.episodes).map(episode).collect()
}

/// The results; with `--disturbed`, those without disturbances, and under `disturbed` those with them.
fn as_json(
    task: &EnvironmentSpec,
    trained: &Trained,
    plain: &[Episode],
    disturbed: Option<&[Episode]>,
) -> serde_json::Value {
    let mut object = results(&task.reward_terms, trained, plain);
    object["task"] = json!(task.task);
    object["seed"] = json!(trained.config.run.seed);
    object["iteration"] = json!(trained.iteration);
    object["env_steps"] = json!(trained.env_steps);
    if let Some(disturbed) = disturbed {
        object["disturbed"] = results(&task.reward_terms, trained, disturbed);
    }
    object
}

/// Returns of episodes, their statistics and their terms.
fn results(names: &[String], trained: &Trained, episodes: &[Episode]) -> serde_json::Value {
    let spread = Spread::of(episodes.iter().map(|episode| episode.extrinsic_return));
    let as_json = |(index, played): (u32, &Episode)| {
        let id = trained.episode(index).id();
        json!({ "episode_id": id, "return": played.extrinsic_return, "steps": played.steps })
    };
    let mut object = json!({
        "return_mean": spread.mean,
        "return_standard_deviation": spread.standard_deviation,
        "return_minimum": spread.minimum,
        "return_maximum": spread.maximum,
        "episodes": (0..).zip(episodes).map(as_json).collect::<Vec<_>>(),
    });
    for (term, mean) in terms(names, episodes) {
        object[term] = json!(mean);
    }
    object
}

/// Mean over the episodes of each reward term's sum in an episode, as `return/TERM`.
fn terms(names: &[String], episodes: &[Episode]) -> Vec<(String, f64)> {
    let sums: Vec<&[f64]> = episodes.iter().map(|played| played.reward_terms.as_slice()).collect();
    means_per_episode(names, &sums)
}

/// The returns, and the mean of each term that makes them up.
fn as_table(names: &[String], episodes: &[Episode]) -> String {
    let mut text = "episode      return   steps\n".to_owned();
    for (index, Episode { extrinsic_return, steps, .. }) in episodes.iter().enumerate() {
        text += &format!("{index:>7} {extrinsic_return:>11.2} {steps:>7}\n");
    }
    let Spread { mean, standard_deviation, minimum, maximum } =
        Spread::of(episodes.iter().map(|episode| episode.extrinsic_return));
    text += &format!("\nreturn {mean:.2} ± {standard_deviation:.2} ({minimum:.2} to {maximum:.2})");
    for (term, mean) in terms(names, episodes) {
        text += &format!("\n{term} {mean:.2}");
    }
    text
}
