//! Checks the end states of a slot before they count: whether they can be decoded, and whether they continue the episodes of
//! the slot.

use std::fmt;
use std::sync::Arc;

use proto::{
    EpisodePosition, Reason, Refusal, RolloutWork, RunDescription, Start, TrajectoryChunk,
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
        if found != expected {
            return Err(format!("it is at {found}, its environment is at {expected}"));
        }
        Ok(())
    }

    /// Checks the end states of a slot, whose environments went through `courses`.
    ///
    /// # Errors
    /// Refuses the first state that is invalid or at another position than its environment.
    pub(crate) fn check_end(
        &self,
        slot: &RolloutWork,
        courses: &[Course],
        states: &[Vec<u8>],
        run: &RunDescription,
    ) -> Result<(), Refusal> {
        let environments = slot.environments.iter().zip(courses).zip(states);
        for (i, ((start, course), state)) in environments.enumerate() {
            let checked = match self.position_after(&start.start, *course, run) {
                Some(expected) => self.check(state, expected),
                None => self.decode(state).map(drop),
            };
            checked.map_err(|detail| {
                Refusal::new(Reason::BadValue, format!("chunk.end.environments[{i}]"), detail)
            })?;
        }
        Ok(())
    }

    /// Position of an environment after a slot; `None` if its start state cannot be decoded.
    fn position_after(
        &self,
        start: &Start,
        course: Course,
        run: &RunDescription,
    ) -> Option<EpisodePosition> {
        let start = match start {
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

/// What happened to an environment since the start of its slot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Course {
    /// Episodes that ended.
    ended: u64,
    /// Steps since the last of these, or since the start of the slot.
    steps: u32,
}

/// Continues the courses of a slot's environments with a chunk.
pub(crate) fn follow(courses: &mut [Course], chunk: &TrajectoryChunk) {
    let flags = chunk.terminated.iter().zip(&chunk.truncated);
    let environments = (0..courses.len()).cycle();
    for (environment, (terminated, truncated)) in environments.zip(flags) {
        let course = &mut courses[environment];
        course.steps += 1;
        if *terminated || *truncated {
            *course = Course { ended: course.ended + 1, steps: 0 };
        }
    }
}
