//! A cheap proof that an actor acted as it says: the learner runs the named policy over the chunk's own
//! observations, from the stored recurrent states, and compares. Wrong weights, a wrong recurrent state
//! or another order of observations show at once.

use policy::{ActorPolicy, PolicySnapshot, Scratch};
use proto::{AgentChunk, Reason, Refusal, RunDescription, TrajectoryChunk};

/// Largest difference between the actor's and the learner's log-probability (nats) or recurrent state.
/// Another program's rounding stays well below it, another policy does not.
pub const TOLERANCE: f32 = 1e-3;

/// Whether `policy` gives the chunk's log-probabilities and leads from each stored recurrent state to the
/// next one. The chunk has been validated for `run`, and the policy fits the run's environment.
///
/// # Errors
/// Refuses the first agent and step at which they differ.
pub fn check(
    policy: &PolicySnapshot,
    run: &RunDescription,
    chunk: &TrajectoryChunk,
) -> Result<(), Refusal> {
    let environments = run.environments_per_slot as usize;
    let done =
        chunk.terminated.iter().zip(&chunk.truncated).map(|(a, b)| *a || *b).collect::<Vec<_>>();
    for (i, (policy, rows)) in policy.agents.iter().zip(&chunk.agents).enumerate() {
        let end = chunk.end.as_ref().map(|end| end.recurrent[i].as_slice());
        let replay = Replay { policy, rows, environments, done: &done, end };
        replay.run(run.hidden_every as usize).map_err(|(field, detail)| {
            Refusal::new(Reason::CanaryMismatch, format!("chunk.agents[{i}].{field}"), detail)
        })?;
    }
    Ok(())
}

/// One agent's rows of a chunk, and the policy that should have made them.
struct Replay<'a> {
    policy: &'a ActorPolicy,
    rows: &'a AgentChunk,
    environments: usize,
    /// `[t, E]`: the episode ended with this step.
    done: &'a [bool],
    /// `[E, H]` after the slot's last step, in its last chunk.
    end: Option<&'a [f32]>,
}

/// The field that differs, and how.
type Mismatch = (&'static str, String);

impl Replay<'_> {
    fn run(&self, every: usize) -> Result<(), Mismatch> {
        let steps = self.done.len() / self.environments;
        let width = self.environments * self.policy.hidden_size();
        let mut output = vec![0.0; self.environments * self.policy.output_size()];
        let mut scratch = Scratch::default();
        for (block, first) in (0..steps).step_by(every).enumerate() {
            let mut hidden = self.rows.hidden[block * width..(block + 1) * width].to_vec();
            for step in first..first + every {
                self.step(step, &mut hidden, &mut output, &mut scratch)?;
            }
            let next = match first + every == steps {
                true => self.end,
                false => Some(&self.rows.hidden[(block + 1) * width..(block + 2) * width]),
            };
            next.map_or(Ok(()), |next| self.same_state(first + every, &hidden, next))?;
        }
        Ok(())
    }

    /// Compares a step's log-probabilities; `hidden` `[E, H]` moves on by it, and is zero after an end.
    fn step(
        &self,
        step: usize,
        hidden: &mut [f32],
        output: &mut [f32],
        scratch: &mut Scratch,
    ) -> Result<(), Mismatch> {
        let (count, act) = (self.environments, self.policy.action_size());
        let out = self.policy.output_size();
        let row = count * self.policy.observation_size();
        let observation = &self.rows.observation[step * row..(step + 1) * row];
        self.policy.forward(count, observation, hidden, output, scratch);
        for e in 0..count {
            let at = step * count + e;
            let action = &self.rows.action[at * act..][..act];
            let expected = self.policy.log_prob(&output[e * out..][..out], action);
            let found = self.rows.log_prob[at];
            if differs(found, expected) {
                let detail = format!(
                    "{found} at step {step} of environment {e}, the learner gets {expected}"
                );
                return Err(("log_prob", detail));
            }
            if self.done[at] {
                let width = self.policy.hidden_size();
                hidden[e * width..(e + 1) * width].fill(0.0);
            }
        }
        Ok(())
    }

    fn same_state(&self, step: usize, expected: &[f32], found: &[f32]) -> Result<(), Mismatch> {
        let mut pairs = found.iter().zip(expected);
        match pairs.position(|(found, expected)| differs(*found, *expected)) {
            None => Ok(()),
            Some(at) => {
                let (e, unit) = (at / self.policy.hidden_size(), at % self.policy.hidden_size());
                let (found, expected) = (found[at], expected[at]);
                let detail = format!(
                    "{found} before step {step} of environment {e}, unit {unit}; the learner gets {expected}"
                );
                Err(("hidden", detail))
            }
        }
    }
}

/// NaN differs from everything.
fn differs(found: f32, expected: f32) -> bool {
    let distance = (found - expected).abs();
    distance.is_nan() || distance > TOLERANCE
}
