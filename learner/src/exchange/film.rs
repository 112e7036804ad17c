//! The newest film of an evaluated episode, for whoever watches the run. The learner only hands it on.

use std::sync::Arc;

use proto::{EvaluationResult, Film, PolicyVersion, PushHeader};

use crate::exchange::Exchange;

/// What an evaluated episode looked like.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmedEpisode {
    /// The policies that played it.
    pub version: PolicyVersion,
    /// What it came to.
    pub result: EvaluationResult,
    /// Its beginning.
    pub film: Film,
}

impl Exchange {
    /// Keeps the film of an episode that was accepted in place of the one before, unless that shows newer policies.
    pub fn keep_film(&self, header: &PushHeader, result: EvaluationResult, film: Film) {
        let version = header.weights.version;
        let mut shared = self.lock();
        if shared.film.as_ref().is_none_or(|shown| shown.version <= version) {
            shared.film = Some(Arc::new(FilmedEpisode { version, result, film }));
        }
    }

    /// The newest film, once there is one.
    #[must_use]
    pub fn film(&self) -> Option<Arc<FilmedEpisode>> {
        self.lock().film.clone()
    }
}
