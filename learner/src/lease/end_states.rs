//! Checks the end states of a slot before they count: whether they can be decoded, and whether they continue the episodes of
//! the slot.

use std::fmt;
use std::sync::Arc;

use proto::{
    EnvironmentStart, EpisodePosition, Reason, Refusal, RolloutWork, RunDescription, Start,
    TrajectoryChunk,
};

/// Decodes an encoded state; an error says why it is invalid.
type Decode = dyn Fn(&[u8]) -> Result<EpisodePosition, String> + Send + Sync;

/// Decodes the states of the run's environments, as far as they can be decoded without the environment. The learner itself
/// knows no encoding.
#[derive(Clone)]
pub struct StateReader(Arc<Decode>);

impl fmt::Debug for StateReader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("StateReader")
    }
}

impl StateReader {
    /// A decoder that calls `decode`, whose error says why a state is invalid.
    #[must_use]
    pub fn new(
        decode: impl Fn(&[u8]) -> Result<EpisodePosition, String> + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(decode))
    }

    /// The position of a state.
    ///
    /// # Errors
    /// Says why the state is invalid.
    pub fn decode(&self, state: &[u8]) -> Result<EpisodePosition, String> {
        (self.0)(state)
    }

    /// Checks that a state can be decoded and has this position.
    pub(crate) fn check(&self, state: &[u8], expected: EpisodePosition) -> Result<(), String> {
        let found = self.decode(state)?;
        match found == expected {
            true => Ok(()),
            false => Err(format!("it is at {found}, its environment is at {expected}")),
        }
    }

    /// Checks the end states of a slot. `chunks` are all its chunks.
    ///
    /// # Errors
    /// Refuses the first state that is invalid or at another position than its environment.
    pub(crate) fn check_end(&self, slot: &SlotCourse, run: &RunDescription) -> Result<(), Refusal> {
        for (i, (state, course)) in slot.states.iter().zip(&slot.courses).enumerate() {
            let expected = self.position_after(course, run);
            let checked = match expected {
                Some(expected) => self.check(state, expected),
                None => self.decode(state).map(drop),
            };
            checked.map_err(|detail| {
                Refusal::new(Reason::BadValue, format!("chunk.end.environments[{i}]"), detail)
            })?;
        }
        Ok(())
    }

    /// EpisodePosition of an environment after a slot; `None` if its start state cannot be decoded.
    fn position_after(&self, course: &Course, run: &RunDescription) -> Option<EpisodePosition> {
        let start = match &course.start {
            Start::Fresh { episode, limit } => {
                EpisodePosition { episode: *episode, step: 0, limit: *limit }
            }
            Start::Continue { state, .. } => self.decode(state).ok()?,
        };
        Some(match course.ended {
            0 => EpisodePosition { step: start.step.saturating_add(course.steps), ..start },
            ended => EpisodePosition {
                episode: start.episode.saturating_add(ended),
                step: course.steps,
                limit: run.environment.episode_steps,
            },
        })
    }
}

/// The end states of a slot, and what happened to each of its environments.
pub(crate) struct SlotCourse {
    states: Vec<Vec<u8>>,
    courses: Vec<Course>,
}

/// An environment in a slot.
struct Course {
    start: Start,
    /// Episodes that ended in the slot.
    ended: u64,
    /// Steps since the last of these, or since the start of the slot.
    steps: u32,
}

impl SlotCourse {
    /// The course of a slot whose last chunk is `last`, which follows `before`; `None` if `last` has no end states.
    pub(crate) fn new(
        work: &RolloutWork,
        before: &[TrajectoryChunk],
        last: &TrajectoryChunk,
    ) -> Option<Self> {
        let states = last.end.as_ref()?.environments.clone();
        let course =
            |start: &EnvironmentStart| Course { start: start.start.clone(), ended: 0, steps: 0 };
        let mut courses = work.environments.iter().map(course).collect::<Vec<_>>();
        for chunk in before.iter().chain([last]) {
            let flags = chunk.terminated.iter().zip(&chunk.truncated);
            for (row, (terminated, truncated)) in flags.enumerate() {
                let environment = row % courses.len();
                let course = &mut courses[environment];
                course.steps += 1;
                if *terminated || *truncated {
                    (course.ended, course.steps) = (course.ended + 1, 0);
                }
            }
        }
        Some(Self { states, courses })
    }
}
