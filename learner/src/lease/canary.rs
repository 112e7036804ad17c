//! A spot check that an actor acted as it says: the learner runs the named policy over the chunk's own
//! observations, from the stored recurrent states, and compares. Wrong weights or another order of observations show
//! in the first step of the first chunk. Later steps and recurrent states are checked in a sample of the chunks.

use policy::tanh_gaussian::sigma;
use policy::{ActorPolicy, Draw, Head, PolicySnapshot, RunSeed, Scratch, generator};
use proto::{AgentChunk, Reason, Refusal, RolloutOrigin, RunDescription, TrajectoryChunk};

use crate::lease::slots::Trust;

/// Largest difference between the actor's and the learner's log-probability (nats) or recurrent state.
/// Another program's rounding stays well below it, another policy does not. For standard deviations below 0.1, which only the
/// outputs of a tanh-Gaussian have, that of a log-probability grows with their inverse.
pub(crate) const TOLERANCE: f32 = 1e-3;

/// Share of the chunks that are checked whole as long as no check has failed.
pub(crate) const SHARE: f64 = 0.125;

/// How much of a chunk is checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// The first step.
    FirstStep,
    /// Every step and every recurrent state.
    Chunk,
}

/// Whether `policy` gives the chunk's log-probabilities and leads from each stored recurrent state to the
/// next one, as far as `extent` says. The chunk has been validated for `run`, and the policy fits the run's environment.
/// `origin` is the slot. If the actor is exact, the actions of the chunk's first step must also be the ones that the slot's
/// keys draw.
///
/// # Errors
/// Refuses the first agent and step at which they differ.
pub fn check(
    policy: &PolicySnapshot,
    run: &RunDescription,
    chunk: &TrajectoryChunk,
    (origin, trust): (&RolloutOrigin, Trust),
    extent: Extent,
) -> Result<(), Refusal> {
    let environments = chunk.reward.len() / chunk.steps as usize;
    let (checked, end) = match extent {
        Extent::FirstStep => (environments, None),
        Extent::Chunk => (chunk.reward.len(), chunk.end.as_ref()),
    };
    let ends = chunk.terminated.iter().zip(&chunk.truncated).take(checked);
    let done = ends.map(|(terminated, truncated)| *terminated || *truncated).collect::<Vec<_>>();
    let mut scratch = Scratch::default();
    for (i, (policy, rows)) in policy.agents.iter().zip(&chunk.agents).enumerate() {
        let end = end.map(|end| end.recurrent[i].as_slice());
        // A policy without memory starts anew at each step.
        let every = match extent {
            Extent::Chunk if policy.hidden_size() > 0 => run.hidden_every as usize,
            _ => 1,
        };
        let draw = |step, environment| {
            Draw::of_action(origin.iteration, environment, chunk.first_step + step, i as u32)
        };
        let replay = Replay {
            policy,
            rows,
            environments,
            every,
            done: &done,
            end,
            seed: RunSeed(run.seed),
            draw: &draw,
            indices: &origin.environments,
        };
        let found = replay.run(&mut scratch).and_then(|first| {
            if trust == Trust::Exact { replay.same_actions(&first) } else { Ok(()) }
        });
        found.map_err(|(field, detail)| {
            Refusal::new(Reason::CanaryMismatch, format!("chunk.agents[{i}].{field}"), detail)
        })?;
    }
    Ok(())
}

/// One agent's rows of a chunk, of which the first are checked, and the policy that should have made them. A block is
/// the `every` steps between two stored recurrent states.
struct Replay<'a> {
    policy: &'a ActorPolicy,
    rows: &'a AgentChunk,
    environments: usize,
    every: usize,
    /// `[t, E]`: the episode ended with this step, for each checked step.
    done: &'a [bool],
    /// `[E, H]` after the slot's last step, in its last chunk if that is checked whole.
    end: Option<&'a [f32]>,
    seed: RunSeed,
    /// The environments' indices over the whole run, `[E]`.
    indices: &'a [u32],
    /// The key of the action in a step of the chunk and an environment of the run.
    draw: &'a dyn Fn(u32, u32) -> Draw,
}

/// What the policy makes of a chunk's observations.
struct ReplayOutput {
    /// `[every, blocks, E, out]`, with the noise that agents share.
    output: Vec<f32>,
    /// `[blocks, E, H]` after each block.
    hidden: Vec<f32>,
}

/// The field that differs, and how.
type Mismatch = (&'static str, String);

impl Replay<'_> {
    /// Compares log-probabilities and recurrent states; returns the outputs of the first step, `[E, out]`.
    fn run(&self, scratch: &mut Scratch) -> Result<Vec<f32>, Mismatch> {
        let replayed = self.replay(scratch);
        let width = self.environments * self.policy.hidden_size();
        for block in 0..self.blocks() {
            for step in 0..self.every {
                self.same_log_probs(block, step, &replayed.output)?;
            }
            let own = block * width..(block + 1) * width;
            let next = if block + 1 == self.blocks() {
                self.end
            } else {
                Some(&self.rows.hidden[own.end..own.end + width])
            };
            let after = (block + 1) * self.every;
            next.map_or(Ok(()), |next| self.same_state(after, &replayed.hidden[own], next))?;
        }
        let mut first = replayed.output;
        first.truncate(self.environments * self.policy.output_size());
        Ok(first)
    }

    /// Compares the actions of the first step with those that the slot's keys draw.
    fn same_actions(&self, output: &[f32]) -> Result<(), Mismatch> {
        let width = self.policy.action_size();
        let mut drawn = vec![0.0; width];
        let outputs = output.chunks_exact(self.policy.output_size());
        let rows = outputs.zip(self.rows.action.chunks_exact(width));
        for (e, ((output, found), index)) in rows.zip(self.indices).enumerate() {
            let key = (self.draw)(0, *index);
            self.policy.draw(output, &mut generator(self.seed, key), &mut drawn);
            if found.iter().zip(&drawn).any(|(found, drawn)| differs(*found, *drawn)) {
                let detail = format!(
                    "{found:?} at step 0 of environment {e}, the slot's random key gives {drawn:?}"
                );
                return Err(("action", detail));
            }
        }
        Ok(())
    }

    fn blocks(&self) -> usize {
        self.done.len() / self.environments / self.every
    }

    /// Runs the policy over all blocks side by side: each starts from its own stored state, so one forward pass takes
    /// a step of every block.
    fn replay(&self, scratch: &mut Scratch) -> ReplayOutput {
        let count = self.environments;
        let blocks = self.blocks();
        let (obs, units) = (self.policy.observation_size(), self.policy.hidden_size());
        let size = blocks * count * self.policy.output_size();
        let mut hidden = self.rows.hidden[..blocks * count * units].to_vec();
        let mut output = vec![0.0; self.every * size];
        let mut observation = Vec::with_capacity(blocks * count * obs);
        for (step, output) in output.chunks_exact_mut(size).enumerate() {
            observation.clear();
            let rows = self.rows.observation.chunks_exact(self.every * count * obs);
            for block in rows.take(blocks) {
                observation.extend_from_slice(&block[step * count * obs..][..count * obs]);
            }
            self.policy.forward(blocks * count, &observation, &mut hidden, output, scratch);
            for (row, output) in output.chunks_exact_mut(self.policy.output_size()).enumerate() {
                let time = row / count * self.every + step;
                let key = (self.draw)(time as u32, self.indices[row % count]);
                self.policy.add_shared_noise(self.seed, key, output);
            }
            for row in (0..blocks * count).filter(|row| self.is_done(*row, step)) {
                hidden[row * units..(row + 1) * units].fill(0.0);
            }
        }
        ReplayOutput { output, hidden }
    }

    /// Whether an episode ended with this step of its block; `row` is `block * E + e`.
    fn is_done(&self, row: usize, step: usize) -> bool {
        let block = row / self.environments;
        let e = row % self.environments;
        self.done[(block * self.every + step) * self.environments + e]
    }

    /// Compares the log-probabilities of one step.
    fn same_log_probs(&self, block: usize, step: usize, output: &[f32]) -> Result<(), Mismatch> {
        let count = self.environments;
        let act = self.policy.action_size();
        let out = self.policy.output_size();
        let first = (step * self.blocks() + block) * count;
        let time = block * self.every + step;
        for e in 0..count {
            let at = time * count + e;
            let action = &self.rows.action[at * act..][..act];
            let output = &output[(first + e) * out..][..out];
            let expected = self.policy.log_prob(output, action);
            let found = self.rows.log_prob[at];
            let ls = match self.policy.head() {
                Head::TanhGaussian { .. } => &output[act..],
                _ => &[],
            };
            let scale = sensitivity(self.policy.own_part(), ls);
            if differs(found / scale, expected / scale) {
                let detail = format!(
                    "{found} at step {time} of environment {e}, the learner gets {expected}"
                );
                return Err(("log_prob", detail));
            }
        }
        Ok(())
    }

    fn same_state(&self, step: usize, expected: &[f32], found: &[f32]) -> Result<(), Mismatch> {
        let mut pairs = found.iter().zip(expected);
        match pairs.position(|(found, expected)| differs(*found, *expected)) {
            None => Ok(()),
            Some(at) => {
                let e = at / self.policy.hidden_size();
                let unit = at % self.policy.hidden_size();
                let (found, expected) = (found[at], expected[at]);
                let detail = format!(
                    "{found} before step {step} of environment {e}, unit {unit}; the learner gets {expected}"
                );
                Err(("hidden", detail))
            }
        }
    }
}

/// How much more than at a standard deviation of 0.1 a log-probability changes with the outputs of a policy whose standard deviations
/// given the signal, by `ls` `[act]` times their `own` part, may be smaller; at least 1, also without `ls`.
fn sensitivity(own: &[f64], ls: &[f32]) -> f32 {
    ls.iter().zip(own).fold(1.0, |most, (l, own)| (0.1 / (sigma(*l) * own)).max(most)) as f32
}

/// NaN differs from everything.
fn differs(found: f32, expected: f32) -> bool {
    let distance = (found - expected).abs();
    distance.is_nan() || distance > TOLERANCE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_probability_may_differ_more_the_smaller_a_standard_deviation_below_a_tenth_is() {
        // tanh(-20) is -1: the deviation is exp(-5). At 0 it is exp(-1.5).
        assert!((sensitivity(&[1.0; 2], &[0.0, -20.0]) - 14.841_316).abs() < 1e-3);
        assert_eq!(sensitivity(&[1.0; 2], &[0.0, 20.0]), 1.0);
        assert_eq!(sensitivity(&[1.0], &[]), 1.0);
        // With a loading of 0.6 the deviation given the signal is 0.8 as large.
        assert!((sensitivity(&[0.8], &[-20.0]) - 18.551_645).abs() < 1e-3);
    }
}
