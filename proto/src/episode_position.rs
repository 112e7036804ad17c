//! Position in an episode.

use std::fmt;

/// Position of an environment in its episode, which every encoded state contains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EpisodePosition {
    /// Index of the episode in its environment.
    pub episode: u64,
    /// Steps taken in the episode.
    pub step: u32,
    /// Steps after which the episode is truncated.
    pub limit: u32,
}

/// `step 3 of 50 of episode 7`
impl fmt::Display for EpisodePosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { episode, step, limit } = self;
        write!(f, "step {step} of {limit} of episode {episode}")
    }
}
