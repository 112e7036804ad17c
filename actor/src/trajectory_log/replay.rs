//! Playing a log once more: the simulator steps from each stored state with the logged actions, and must come to the
//! same observations, states and rewards, bit for bit.

use std::fmt;

use proto::trajectory_log::ShareEnd;
use sim::{EnvironmentBatch, Outcome};

use super::LogError;
use super::shares::{LoggedShare, LoggedStep, read_shares};

/// Where the simulator and a log part.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// The episode.
    pub episode_id: String,
    /// The step of the episode.
    pub step: u32,
    /// What differs.
    pub what: String,
    /// What the log says.
    pub logged: String,
    /// What came out.
    pub found: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { episode_id, step, what, logged, found } = self;
        write!(f, "{episode_id}, step {step}: {what} was {logged}, is {found} now")
    }
}

/// What was played once more.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Replayed {
    /// Shares that came out the same.
    pub shares: u64,
    /// Steps that did.
    pub steps: u64,
    /// The first that did not; nothing behind it was played.
    pub difference: Option<Difference>,
    /// The fingerprint of the program that wrote the log, if it is not this program's.
    pub other_program: Option<String>,
}

/// Plays every whole share of a log.
///
/// # Errors
/// If the file is damaged or no trajectory log, or its task or a state is none of this program's.
pub fn replay(bytes: &[u8]) -> Result<Replayed, LogError> {
    let told = read_shares(bytes, |_, _| Ok(()))?;
    let world = sim::environments(&told.task()?, 1);
    let mut player = Player::new(world.map_err(|error| LogError::Unfit(error.to_string()))?);
    let mut replayed = Replayed::default();
    read_shares(bytes, |share, _| {
        if replayed.difference.is_none() {
            match player.play(&share)? {
                Some(difference) => replayed.difference = Some(difference),
                None => {
                    replayed.shares += 1;
                    replayed.steps += share.steps.len() as u64;
                }
            }
        }
        Ok(())
    })?;
    let own = crate::rollout_fingerprint().to_string();
    replayed.other_program =
        told.words.get("rollout_fingerprint").filter(|logged| **logged != own).cloned();
    Ok(replayed)
}

/// A world of one environment, and room for what is read from it.
struct Player {
    world: Box<dyn EnvironmentBatch>,
    state: Vec<f32>,
    observations: Vec<Vec<f32>>,
}

impl Player {
    fn new(world: Box<dyn EnvironmentBatch>) -> Self {
        let description = world.description();
        let state = vec![0.0; description.state.len()];
        let agents = description.agents.iter();
        let observations = agents.map(|agent| vec![0.0; agent.observation.len()]).collect();
        Self { world, state, observations }
    }

    /// The first difference in a share, if there is one.
    fn play(&mut self, share: &LoggedShare) -> Result<Option<Difference>, LogError> {
        let (episode, first) = (&share.head.episode_id, share.head.first_step);
        let unfit = |why: String| LogError::Unfit(format!("{episode} from step {first} on: {why}"));
        self.world.restore(0, &share.head.environment_state).map_err(|e| unfit(e.to_string()))?;
        for step in &share.steps {
            let parted = self.step(step).map_err(unfit)?;
            if let Some(parted) = parted {
                return Ok(Some(parted.of(episode, step.step.step)));
            }
        }
        Ok(self.arrive(&share.end).map(|parted| parted.of(episode, share.next_step())))
    }

    fn step(&mut self, logged: &LoggedStep) -> Result<Option<Parted>, String> {
        let observations = logged.agents.iter().map(|agent| agent.observation.as_slice());
        if let Some(parted) = self.look(&logged.step.state, observations) {
            return Ok(Some(parted));
        }
        let actions: Vec<f32> =
            logged.agents.iter().flat_map(|agent| agent.action.iter().copied()).collect();
        let mut outcomes = [Outcome::default()];
        self.world.step(&actions, &mut outcomes).map_err(|error| error.to_string())?;
        let [Outcome { reward, terminated, truncated, .. }] = outcomes;
        let step = &logged.step;
        Ok(number("the reward", step.reward, reward)
            .or_else(|| value("terminated", step.terminated, terminated))
            .or_else(|| value("truncated", step.truncated, truncated)))
    }

    /// Behind a share's last step.
    fn arrive(&mut self, end: &ShareEnd) -> Option<Parted> {
        let observations = end.observations.iter().map(|row| row.observation.as_slice());
        self.look(&end.state, observations).or_else(|| {
            let logged = &end.environment_state;
            let same =
                logged.is_empty() || self.world.encode(0).is_ok_and(|found| found == *logged);
            value("the encoded state is the logged one", true, same)
        })
    }

    /// Whether the world looks as it was logged.
    fn look<'a>(
        &mut self,
        state: &[f32],
        observations: impl ExactSizeIterator<Item = &'a [f32]>,
    ) -> Option<Parted> {
        self.world.state(0, &mut self.state);
        let name = |index: usize| {
            let feature = &self.world.description().state[index].name;
            format!("the global state's {feature}")
        };
        if let Some(parted) = numbers("the global state", state, &self.state, name) {
            return Some(parted);
        }
        let agents = (observations.len(), self.observations.len());
        if let Some(parted) = value("the number of agents", agents.0, agents.1) {
            return Some(parted);
        }
        for (agent, logged) in observations.enumerate() {
            self.world.observation(0, agent, &mut self.observations[agent]);
            let features = &self.world.description().agents[agent].observation;
            let name =
                |index: usize| format!("agent {agent}'s observation of {}", features[index].name);
            let what = format!("agent {agent}'s observation");
            if let Some(parted) = numbers(&what, logged, &self.observations[agent], name) {
                return Some(parted);
            }
        }
        None
    }
}

/// A difference whose place is not known yet.
struct Parted {
    what: String,
    logged: String,
    found: String,
}

impl Parted {
    fn of(self, episode_id: &str, step: u32) -> Difference {
        let Self { what, logged, found } = self;
        Difference { episode_id: episode_id.to_owned(), step, what, logged, found }
    }
}

/// The first numbers whose bits differ.
fn numbers(
    what: &str,
    logged: &[f32],
    found: &[f32],
    name: impl Fn(usize) -> String,
) -> Option<Parted> {
    value(&format!("the length of {what}"), logged.len(), found.len()).or_else(|| {
        let at = logged.iter().zip(found).position(|(a, b)| a.to_bits() != b.to_bits())?;
        number(&name(at), logged[at], found[at])
    })
}

fn number(what: &str, logged: f32, found: f32) -> Option<Parted> {
    let parted = || Parted {
        what: what.to_owned(),
        logged: format!("{logged:?}"),
        found: format!("{found:?}"),
    };
    (logged.to_bits() != found.to_bits()).then(parted)
}

fn value<T: PartialEq + fmt::Debug>(what: &str, logged: T, found: T) -> Option<Parted> {
    let parted = || Parted {
        what: what.to_owned(),
        logged: format!("{logged:?}"),
        found: format!("{found:?}"),
    };
    (logged != found).then(parted)
}
