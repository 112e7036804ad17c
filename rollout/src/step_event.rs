//! The steps of environments that are being played, for observers.

use sim::{EnvironmentBatch, Outcome};

/// What an observer of environments sees of each step.
pub enum StepEvent<'a> {
    /// The environments before the step with this index in the slot or episode.
    Before(u32, &'a dyn EnvironmentBatch),
    /// The environments after the step, before any reset.
    After(PlayedStep<'a>),
}

/// A step of played environments. Rows are in the order of the environments.
pub struct PlayedStep<'a> {
    /// The environments after the step.
    pub world: &'a dyn EnvironmentBatch,
    /// Number of steps so far, including this one.
    pub step: u32,
    /// Observations of each agent before the step, `[E, obs]`.
    pub observation: &'a [Vec<f32>],
    /// Recurrent states of each agent after the step, `[E, H]`.
    pub hidden: &'a [Vec<f32>],
    /// Actions of each agent, `[E, act]`.
    pub actions: &'a [Vec<f32>],
    /// Log-probabilities of each agent's actions, `[E]`; `None` in evaluation episodes.
    pub log_probs: Option<&'a [Vec<f32>]>,
    /// Signals in the noise of all agents, `[E, K]`; empty if they share none, in a warm-up, and with mean actions.
    pub signal: &'a [f32],
    /// Results of the step, `[E]`.
    pub outcomes: &'a [Outcome],
}
