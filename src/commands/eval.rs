//! `s2mia eval`: whole episodes of a trained policy, mean action, extrinsic return only.

use std::path::Path;

use actor::EnvironmentBatch;
use anyhow::Context as _;
use policy::{Draw, Key, Purpose, RunSeed};
use serde_json::json;

use crate::chart;
use crate::cli::EvalArguments;
use crate::commands::checkpointed::{self, Trained};
use crate::offered::Stage;
use crate::output;

/// The first states are those that the run's own evaluation of this iteration would use.
pub(super) fn run(arguments: &EvalArguments) -> anyhow::Result<()> {
    let trained = checkpointed::trained(&arguments.run)?;
    let mut stage = Stage::of(&trained.config)?;
    let returns = play(stage.environment.as_mut(), &trained, arguments.episodes)?;
    let task = &stage.environment.description().task;
    let world = if stage.environment.simulated().is_some() { "rapier/" } else { "" };
    let spread = Spread::of(&returns);
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
    episodes: u32,
) -> anyhow::Result<Vec<(f64, u32)>> {
    let seed = RunSeed(trained.config.run.seed);
    let mut returns = Vec::new();
    for episode in 0..episodes {
        let draw =
            Draw::of(Purpose::EvaluationReset).iteration(trained.iteration).environment(episode);
        let key = Key::of(seed, draw);
        let played = actor::play_episode(world, &trained.policy, key, |_| {})
            .context("the episode broke off")?;
        returns.push((played.extrinsic_return, played.steps));
    }
    Ok(returns)
}

/// Mean, standard deviation over the episodes, and extremes.
struct Spread {
    mean: f64,
    standard_deviation: f64,
    minimum: f64,
    maximum: f64,
}

impl Spread {
    fn of(returns: &[(f64, u32)]) -> Self {
        let count = returns.len() as f64;
        let values = || returns.iter().map(|episode| episode.0);
        let mean = values().sum::<f64>() / count;
        let variance = values().map(|value| (value - mean) * (value - mean)).sum::<f64>() / count;
        Self {
            mean,
            standard_deviation: variance.sqrt(),
            minimum: values().fold(f64::INFINITY, f64::min),
            maximum: values().fold(f64::NEG_INFINITY, f64::max),
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_of_two_episodes() {
        let spread = Spread::of(&[(1.0, 10), (3.0, 10)]);
        assert_eq!((spread.mean, spread.standard_deviation), (2.0, 1.0));
        assert_eq!((spread.minimum, spread.maximum), (1.0, 3.0));
    }
}
