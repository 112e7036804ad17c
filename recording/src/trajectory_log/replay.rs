//! Replays a log: the simulator steps from each stored state with the logged actions and must reproduce the
//! observations, states, rewards and their terms bit for bit.

use std::fmt::{self, Debug};

use proto::trajectory_log::ShareEnd;
use sim::{EnvironmentBatch, Outcome};

use super::error::LogError;
use super::shares::read_shares;
use crate::share::{LoggedShare, LoggedStep};

/// First difference between the simulator and a log.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayDifference {
    /// The episode.
    pub episode_id: String,
    /// The step of the episode.
    pub step: u32,
    /// Quantity that differs.
    pub what: String,
    /// Value in the log.
    pub logged: String,
    /// Value of the simulator.
    pub found: String,
}

impl fmt::Display for ReplayDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { episode_id, step, what, logged, found } = self;
        write!(f, "{episode_id}, step {step}: {what} differs: logged {logged}, replayed {found}")
    }
}

/// Result of a replay.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Replayed {
    /// Number of identical shares.
    pub shares: u64,
    /// Number of steps of these shares.
    pub steps: u64,
    /// First difference; nothing after it was replayed.
    pub difference: Option<ReplayDifference>,
    /// Fingerprint of the program that wrote the log, if it differs from this program's.
    pub other_program: Option<String>,
}

/// Replays all complete shares of a log. `on_share` gets the number of replayed steps and of all steps after each share.
///
/// # Errors
/// If the file is damaged or not a trajectory log, or this program does not support its task or a state.
pub fn replay(bytes: &[u8], mut on_share: impl FnMut(u64, u64)) -> Result<Replayed, LogError> {
    let mut all = 0;
    let log = read_shares(bytes, |share| {
        all += share.steps.len() as u64;
        Ok(())
    })?;
    let world = sim::environments(&log.task()?, 1);
    let world = world.map_err(|error| LogError::Unfit(error.to_string()))?;
    let mut player = Player { world };
    let mut replayed = Replayed::default();
    read_shares(bytes, |share| {
        if replayed.difference.is_none() {
            match player.play(&share)? {
                Some(difference) => replayed.difference = Some(difference),
                None => {
                    replayed.shares += 1;
                    replayed.steps += share.steps.len() as u64;
                    on_share(replayed.steps, all);
                }
            }
        }
        Ok(())
    })?;
    let own = rollout::rollout_fingerprint().to_string();
    replayed.other_program =
        log.words.get("rollout_fingerprint").filter(|logged| **logged != own).cloned();
    Ok(replayed)
}

/// One environment.
struct Player {
    world: Box<dyn EnvironmentBatch>,
}

impl Player {
    /// Replays a share; returns the first difference, if any.
    fn play(&mut self, share: &LoggedShare) -> Result<Option<ReplayDifference>, LogError> {
        let episode = &share.head.episode_id;
        let first = share.head.first_step;
        let unfit = |why: String| LogError::Unfit(format!("{episode} from step {first} on: {why}"));
        self.world.restore(0, &share.head.environment_state).map_err(|e| unfit(e.to_string()))?;
        for step in &share.steps {
            let mismatch = self.step(step).map_err(unfit)?;
            if let Some(mismatch) = mismatch {
                return Ok(Some(mismatch.of(episode, step.step.step)));
            }
        }
        Ok(self.compare_end(&share.end).map(|mismatch| mismatch.of(episode, share.next_step())))
    }

    fn step(&mut self, logged: &LoggedStep) -> Result<Option<Mismatch>, String> {
        let observations = logged.agents.iter().map(|agent| agent.observation.as_slice());
        if let Some(mismatch) = self.compare(&logged.step.state, observations) {
            return Ok(Some(mismatch));
        }
        let actions: Vec<f32> =
            logged.agents.iter().flat_map(|agent| agent.action.iter().copied()).collect();
        let mut outcomes = [Outcome::default()];
        self.world.step(&actions, &mut outcomes).map_err(|error| error.to_string())?;
        let [Outcome { reward, terminated, truncated, .. }] = outcomes;
        let step = &logged.step;
        let terms = &self.world.description().reward_terms;
        let term = |index: usize| format!("the reward's term {}", terms[index]);
        let found = self.world.reward_terms(0);
        Ok(number("the reward", step.reward, reward)
            .or_else(|| numbers("the reward's terms", &step.reward_terms, found, term))
            .or_else(|| value("terminated", step.terminated, terminated))
            .or_else(|| value("truncated", step.truncated, truncated)))
    }

    /// Compares the state after the last step of a share.
    fn compare_end(&self, end: &ShareEnd) -> Option<Mismatch> {
        let observations = end.observations.iter().map(|row| row.observation.as_slice());
        self.compare(&end.state, observations).or_else(|| {
            let logged = &end.environment_state;
            let same =
                logged.is_empty() || self.world.encode(0).is_ok_and(|found| found == *logged);
            value("the equality of encoded states", true, same)
        })
    }

    /// Compares the current state and observations with the logged ones.
    fn compare<'a>(
        &self,
        state: &[f32],
        observations: impl ExactSizeIterator<Item = &'a [f32]>,
    ) -> Option<Mismatch> {
        let found = self.world.state_of(0);
        let name = |index: usize| {
            let feature = &self.world.description().state[index].name;
            format!("the global state's {feature}")
        };
        if let Some(mismatch) = numbers("the global state", state, &found, name) {
            return Some(mismatch);
        }
        let found = self.world.observations_of(0);
        if let Some(mismatch) = value("the number of agents", observations.len(), found.len()) {
            return Some(mismatch);
        }
        for (agent, (logged, found)) in observations.zip(found).enumerate() {
            let features = &self.world.description().agents[agent].observation;
            let name =
                |index: usize| format!("agent {agent}'s observation of {}", features[index].name);
            let what = format!("agent {agent}'s observation");
            if let Some(mismatch) = numbers(&what, logged, &found, name) {
                return Some(mismatch);
            }
        }
        None
    }
}

/// A difference without its episode and step.
struct Mismatch {
    what: String,
    logged: String,
    found: String,
}

impl Mismatch {
    fn of(self, episode_id: &str, step: u32) -> ReplayDifference {
        let Self { what, logged, found } = self;
        ReplayDifference { episode_id: episode_id.to_owned(), step, what, logged, found }
    }
}

/// First pair of numbers with different bits.
fn numbers(
    what: &str,
    logged: &[f32],
    found: &[f32],
    name: impl Fn(usize) -> String,
) -> Option<Mismatch> {
    value(&format!("the length of {what}"), logged.len(), found.len()).or_else(|| {
        let at = logged.iter().zip(found).position(|(a, b)| a.to_bits() != b.to_bits())?;
        number(&name(at), logged[at], found[at])
    })
}

fn number(what: &str, logged: f32, found: f32) -> Option<Mismatch> {
    (logged.to_bits() != found.to_bits()).then(|| mismatch(what, &logged, &found))
}

fn value<T: PartialEq + Debug>(what: &str, logged: T, found: T) -> Option<Mismatch> {
    (logged != found).then(|| mismatch(what, &logged, &found))
}

fn mismatch(what: &str, logged: &dyn Debug, found: &dyn Debug) -> Mismatch {
    Mismatch { what: what.to_owned(), logged: format!("{logged:?}"), found: format!("{found:?}") }
}
