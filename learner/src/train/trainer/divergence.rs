//! Reports that simulated environments diverge: each such step ends an episode early, and a policy learns from what is left. Also
//! reports that the update diverges: steps with a gradient that is not finite are skipped. Weights or policies that have diverged
//! end the run.

use marl::{Batch, TrainingConfig};
use policy::arrays::{Array, NamedArrays};
use policy::{Head, PolicySnapshot, Scratch};

use crate::error::LearnerError;
use crate::observe::event::IterationReport;
use crate::train::trainer::RunningTrainer;

/// Share of an iteration's steps above which divergence is an error: few episodes reach their end.
const SEVERE: f64 = 0.01;

/// Largest mean of a continuous action, whose limits are -1 and 1. Rewards that count squares of actions leave the limit of a message
/// soon after.
const LARGEST_MEAN: f32 = 1e4;

/// Largest mean before tanh: log-densities fall with its square, and soon after leave single precision.
const LARGEST_MEAN_BEFORE_TANH: f32 = 1e8;

const LOWER: &str = "lower update.learning_rate, critic.learning_rate or influence.learning_rate";

/// Counts the iterations in which environments diverged.
#[derive(Debug, Default)]
pub(super) struct Divergence {
    iterations: u64,
    /// Whether a divergence of the update has been reported.
    update_reported: bool,
    /// Optimiser steps skipped so far, as of the last iteration of this start.
    skipped: Option<f64>,
}

/// A network that has diverged.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Diverged {
    /// Name of its weights, such as `agent_0`, `shared` or `critic`.
    network: String,
    /// What is wrong with it.
    why: String,
}

/// The first network with a weight that is not finite.
pub(super) fn infinite(weights: &NamedArrays) -> Option<Diverged> {
    let is_infinite = |array: &Array| match array {
        Array::F32 { data, .. } => data.iter().any(|number| !number.is_finite()),
        Array::F64 { data, .. } => data.iter().any(|number| !number.is_finite()),
        Array::I64 { .. } | Array::U8 { .. } => false,
    };
    let (name, _) = weights.iter().find(|(_, array)| is_infinite(array))?;
    let (network, array) = name.trim_start_matches("weights/").split_once('.')?;
    let why = format!("{array} has a value that is not finite");
    Some(Diverged { network: network.to_owned(), why })
}

/// The first policy whose mean actions are far beyond every limit, for the observations of the last step of `batch`.
pub(super) fn unusable(policies: &PolicySnapshot, batch: &Batch) -> Option<Diverged> {
    let rows = batch.environments;
    let mut scratch = Scratch::default();
    let mut pairs = policies.agents.iter().zip(&batch.agents).enumerate();
    pairs.find_map(|(index, (policy, own))| {
        let first = own.observation.len() - rows * policy.observation_size();
        let mut hidden = vec![0.0; rows * policy.hidden_size()];
        let mut output = vec![0.0; rows * policy.output_size()];
        policy.forward(rows, &own.observation[first..], &mut hidden, &mut output, &mut scratch);
        let mut rows = output.chunks_exact(policy.output_size());
        let (found, largest) =
            rows.find_map(|row| beyond(policy.head(), policy.action_size(), row))?;
        let why = format!("its output is {found:e}, the limit is {largest:e}");
        Some(Diverged { network: format!("agent_{index}"), why })
    })
}

/// The first number of one row's outputs beyond its limit, and the limit.
fn beyond(head: Head, actions: usize, output: &[f32]) -> Option<(f32, f32)> {
    let limit = |index: usize| match head {
        Head::Gaussian | Head::SharedGaussian(_) => LARGEST_MEAN,
        // After the means come the deviations' outputs, which tanh bounds.
        Head::TanhGaussian { .. } if index < actions => LARGEST_MEAN_BEFORE_TANH,
        _ => f32::MAX,
    };
    let mut limited = output.iter().enumerate().map(|(index, value)| (*value, limit(index)));
    limited.find(|(value, largest)| value.is_nan() || value.abs() > *largest)
}

/// The error that ends a run after the update of `iteration`.
pub(super) fn refusal(
    training: &TrainingConfig,
    iteration: u64,
    diverged: &Diverged,
) -> LearnerError {
    let Diverged { network, why } = diverged;
    let (kind, agent) = match network.rsplit_once('_') {
        Some((kind, number)) if number.parse::<usize>().is_ok() => {
            (kind, format!(" of agent {number}"))
        }
        _ => (network.as_str(), String::new()),
    };
    let (words, key, rate) = match kind {
        "agent" => ("policy", "update", training.update.learning_rate),
        "shared" => ("shared policy", "update", training.update.learning_rate),
        "posterior" => ("posterior", "influence", training.influence.learning_rate),
        "critic" | "q" | "target_q" => ("critic", "critic", training.critic.learning_rate),
        other => (other, "update", training.update.learning_rate),
    };
    LearnerError::Other(format!(
        "the {words}{agent} diverged in the update of iteration {iteration}: {why}; start a new run with {key}.learning_rate \
         below {rate:?}; earlier checkpoints are kept"
    ))
}

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Severity {
    /// Some episodes are cut.
    Some,
    /// Few episodes reach their end.
    Severe,
}

impl Divergence {
    /// The line about an iteration of `steps` environment steps, of which `faults` diverged; `None` without a fault, and if
    /// the last line is recent: it comes with the iterations 1, 2, 4, 8 and so on that have faults.
    pub(super) fn report(
        &mut self,
        iteration: u64,
        (faults, steps): (u64, u64),
        remedy: &str,
    ) -> Option<(Severity, String)> {
        if faults == 0 {
            return None;
        }
        self.iterations += 1;
        let severity =
            if faults as f64 > SEVERE * steps as f64 { Severity::Severe } else { Severity::Some };
        let line = format!(
            "the simulation diverged in {faults} of the {steps} environment steps of iteration {iteration}: the robot's \
             state left its bounds, which ended the episodes early (environment_faults); {remedy}"
        );
        self.iterations.is_power_of_two().then_some((severity, line))
    }

    /// The line about the first update that diverges; `None` for others.
    fn update(&mut self, report: &IterationReport) -> Option<String> {
        let figures = || report.metrics.iter();
        let counts = figures().filter(|(name, _)| name.ends_with("skipped_steps"));
        let steps: f64 = counts.map(|(_, count)| count).sum();
        // Checkpoints keep these counts, so those at the first iteration after a resume may be old.
        let known = if report.iteration == 1 { 0.0 } else { steps };
        let new = steps - self.skipped.replace(steps).unwrap_or(known);
        let is_skipped = figures().any(|(name, own)| name == "losses/update_skipped" && *own > 0.0);
        let is_infinite =
            |(name, own): &&(String, f64)| name.ends_with("_loss") && !own.is_finite();
        let why = match figures().find(is_infinite) {
            _ if is_skipped => "it was skipped because returns are not finite (losses/update_skipped): rewards or states are \
                                too large"
                .to_owned(),
            Some((name, own)) => format!("{name} is {own}; {LOWER}"),
            None if new > 1.0 => format!(
                "{new} optimiser steps were skipped because their gradients were not finite (skipped_steps); {LOWER}"
            ),
            None if new > 0.0 => format!(
                "{new} optimiser step was skipped because its gradients were not finite (skipped_steps); {LOWER}"
            ),
            None => return None,
        };
        let line = format!("the update of iteration {} diverges: {why}", report.iteration);
        (!std::mem::replace(&mut self.update_reported, true)).then_some(line)
    }
}

impl RunningTrainer {
    /// Logs once that the update diverges.
    pub(super) fn report_instability(&mut self, report: &IterationReport) {
        if let Some(line) = self.divergence.update(report) {
            tracing::warn!("{line}");
        }
    }

    /// Logs that simulated environments diverged in the iteration just finished.
    pub(super) fn report_divergence(&mut self) {
        let trainer = &self.trainer;
        let remedy = &trainer.launch.divergence_remedy;
        if remedy.is_empty() {
            // An external environment may have its own time limit; reaching it is not a fault.
            return;
        }
        let steps = trainer.launch.config.environments.steps_per_iteration();
        let faults = (trainer.environments.faults, steps);
        match self.divergence.report(trainer.iteration, faults, remedy) {
            Some((Severity::Severe, line)) => tracing::error!("{line}"),
            Some((Severity::Some, line)) => tracing::warn!("{line}"),
            None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_update_with_new_skipped_steps_or_a_loss_that_is_not_finite_is_reported() {
        let report = |iteration: u64, name: &str, value: f64| {
            let metrics = vec![(name.to_owned(), value)];
            IterationReport { iteration, metrics, ..IterationReport::default() }
        };
        let first = |name: &str, value: f64| Divergence::default().update(&report(1, name, value));
        assert_eq!(first("losses/value_loss", 4e44), None);
        assert_eq!(first("agent0/explained_variance", f64::NAN), None);
        for (name, value, words) in [
            ("losses/value_skipped_steps", 498.0, "diverges: 498 optimiser steps were skipped"),
            ("losses/value_loss", f64::NAN, "diverges: losses/value_loss is NaN; lower update."),
            ("losses/update_skipped", 1.0, "rewards or states are too large"),
        ] {
            let line = first(name, value).unwrap();
            assert!(line.contains("iteration 1 ") && line.contains(words), "{line}");
        }
        // Three steps were skipped before a resume, and one after it.
        let mut resumed = Divergence::default();
        let lines = [(900, 3.0), (901, 3.0), (902, 4.0), (903, 5.0)].map(|(iteration, count)| {
            resumed.update(&report(iteration, "agent0/skipped_steps", count)).is_some()
        });
        assert_eq!(lines, [false, false, true, false]);
    }

    #[test]
    fn the_first_weight_that_is_not_finite_ends_the_run_with_its_network_and_learning_rate() {
        let array = |number: f32| Array::F32 { shape: vec![1], data: vec![number] };
        let weights = |name: &str, number| -> NamedArrays {
            let named = [("weights/agent_0.head.bias", 1.0), (name, number)];
            named.into_iter().map(|(name, number)| (name.to_owned(), array(number))).collect()
        };
        assert_eq!(infinite(&weights("weights/critic.head.weight", 1e38)), None);
        for (name, network, why) in [
            ("weights/agent_1.head.bias", "agent_1", "head.bias has a value that is not finite"),
            ("weights/critic.norm.weight", "critic", "norm.weight has a value that is not finite"),
        ] {
            let expected = Diverged { network: network.to_owned(), why: why.to_owned() };
            assert_eq!(infinite(&weights(name, f32::INFINITY)), Some(expected));
        }
    }

    #[test]
    fn outputs_beyond_the_limits_of_their_head_are_found() {
        let squashed = Head::TanhGaussian { low: -1.0, high: 1.0, noise: None };
        assert_eq!(beyond(squashed, 1, &[-9e7, 1e30]), None);
        assert_eq!(beyond(squashed, 1, &[-2e8, 0.0]), Some((-2e8, 1e8)));
        assert!(beyond(squashed, 1, &[0.0, f32::NAN]).is_some_and(|(found, _)| found.is_nan()));
        assert_eq!(beyond(Head::Gaussian, 2, &[1.0, 2e4]), Some((2e4, 1e4)));
        assert_eq!(beyond(Head::Categorical { choices: 2 }, 1, &[1e30, -1e30]), None);
    }

    #[test]
    fn faults_are_reported_at_once_and_then_less_and_less_often() {
        let mut divergence = Divergence::default();
        assert_eq!(divergence.report(1, (0, 200), "lower it"), None);
        let (severity, line) = divergence.report(2, (200, 200), "lower it").unwrap();
        assert_eq!(severity, Severity::Severe);
        assert!(line.contains("200 of the 200 environment steps of iteration 2"), "{line}");
        assert!(line.ends_with("; lower it"), "{line}");
        let reported = (3..10).filter(|k| divergence.report(*k, (1, 200), "").is_some());
        assert_eq!(reported.collect::<Vec<_>>(), [3, 5, 9]);
        assert_eq!(Divergence::default().report(1, (1, 200), "").unwrap().0, Severity::Some);
    }
}
