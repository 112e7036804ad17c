//! `s2mia eval`: whole episodes of a trained policy, mean or drawn actions, extrinsic return only.

use std::path::Path;

use anyhow::Context as _;
use learner::evaluation::Spread;
use proto::ActionChoice;
use serde_json::json;
use sim::EnvironmentBatch;

use crate::chart;
use crate::cli::EvalArguments;
use crate::commands::checkpointed::{self, Trained};
use crate::offered::Stage;
use crate::output;

/// The first states are those that the run's own evaluation of this iteration would use.
pub(super) fn run(arguments: &EvalArguments) -> anyhow::Result<()> {
    let trained = checkpointed::trained(&arguments.run)?;
    let mut stage = Stage::of(&trained.config)?;
    let returns = play(stage.environment.as_mut(), &trained, arguments)?;
    let task = &stage.environment.description().task;
    let world = if trained.config.environment.url.is_empty() { "rapier/" } else { "" };
    let spread = Spread::of(returns.iter().map(|episode| episode.0));
    if arguments.json {
        output::line(as_json(task, &trained, &returns, &spread));
    } else {
        output::line(
            as_table((&arguments.run, &format!("{world}{task}")), &trained, &returns, &spread)
                .trim_end(),
        );
    }
    Ok(())
}

/// Extrinsic return and length of each episode.
fn play(
    world: &mut dyn EnvironmentBatch,
    trained: &Trained,
    arguments: &EvalArguments,
) -> anyhow::Result<Vec<(f64, u32)>> {
    let mut returns = Vec::new();
    for episode in 0..arguments.episodes {
        let choice = match arguments.sampled {
            Some(seed) => ActionChoice::Sampled { seed: seed.wrapping_add(episode.into()) },
            None => ActionChoice::Mean,
        };
        let start = (trained.start(episode), choice);
        let played = actor::play_episode(world, &trained.policy, start, |_| {})
            .context("the episode broke off")?;
        returns.push((played.extrinsic_return, played.steps));
    }
    Ok(returns)
}

fn as_json(
    task: &str,
    trained: &Trained,
    returns: &[(f64, u32)],
    spread: &Spread,
) -> serde_json::Value {
    let episodes: Vec<serde_json::Value> =
        returns.iter().map(|(value, steps)| json!({ "return": value, "steps": steps })).collect();
    json!({
        "task": task,
        "iteration": trained.iteration,
        "env_steps": trained.env_steps,
        "return_mean": spread.mean,
        "return_standard_deviation": spread.standard_deviation,
        "return_minimum": spread.minimum,
        "return_maximum": spread.maximum,
        "episodes": episodes,
    })
}

fn as_table(
    (run, task): (&Path, &str),
    trained: &Trained,
    returns: &[(f64, u32)],
    spread: &Spread,
) -> String {
    let mut text = format!(
        "{}: {task} after {} env steps\n\nepisode      return   steps\n",
        run.display(),
        chart::thousands(trained.env_steps)
    );
    for (episode, (value, steps)) in returns.iter().enumerate() {
        text += &format!("{episode:>7} {value:>11.2} {steps:>7}\n");
    }
    let Spread { mean, standard_deviation, minimum, maximum } = spread;
    text + &format!("\nreturn {mean:.2} ± {standard_deviation:.2} ({minimum:.2} to {maximum:.2})\n")
}
