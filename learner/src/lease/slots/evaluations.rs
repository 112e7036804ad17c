//! Open evaluations and their episodes.

use std::collections::BTreeMap;

use proto::{EvaluationResult, EvaluationWork, LeaseId, WeightsName};

use super::EvaluationOutcome;

/// Open evaluations by iteration.
#[derive(Debug, Default)]
pub(super) struct Evaluations(BTreeMap<u64, Evaluation>);

#[derive(Debug)]
struct Evaluation {
    weights: WeightsName,
    episodes: Vec<Episode>,
}

#[derive(Clone, Debug, Default)]
struct Episode {
    issued: u32,
    holder: Option<LeaseId>,
    result: Option<EvaluationResult>,
}

impl Evaluations {
    pub(super) fn open(&mut self, iteration: u64, weights: WeightsName, episodes: u32) {
        let episodes = vec![Episode::default(); episodes as usize];
        self.0.insert(iteration, Evaluation { weights, episodes });
    }

    pub(super) fn weights(&self) -> impl Iterator<Item = WeightsName> {
        self.0.values().map(|evaluation| evaluation.weights)
    }

    /// The first free episode of the earliest evaluation, and how often it was leased before.
    pub(super) fn claim(&mut self, id: LeaseId) -> Option<(EvaluationWork, WeightsName, u32)> {
        for (iteration, evaluation) in &mut self.0 {
            let free = |episode: &Episode| episode.holder.is_none() && episode.result.is_none();
            if let Some(at) = evaluation.episodes.iter().position(free) {
                let episode = &mut evaluation.episodes[at];
                episode.holder = Some(id);
                episode.issued += 1;
                let work = EvaluationWork { iteration: *iteration, episode: at as u32 };
                return Some((work, evaluation.weights, episode.issued - 1));
            }
        }
        None
    }

    pub(super) fn release(&mut self, work: EvaluationWork) {
        if let Some(episode) = self.episode(work) {
            episode.holder = None;
        }
    }

    /// Takes the result in; the outcome if it was the evaluation's last one.
    pub(super) fn complete(
        &mut self,
        work: EvaluationWork,
        result: EvaluationResult,
    ) -> Option<EvaluationOutcome> {
        let episode = self.episode(work)?;
        episode.holder = None;
        episode.result = Some(result);
        let evaluation = self.0.get(&work.iteration)?;
        let episodes =
            evaluation.episodes.iter().map(|episode| episode.result).collect::<Option<_>>()?;
        self.0.remove(&work.iteration);
        Some(EvaluationOutcome { iteration: work.iteration, episodes })
    }

    fn episode(&mut self, work: EvaluationWork) -> Option<&mut Episode> {
        self.0.get_mut(&work.iteration)?.episodes.get_mut(work.episode as usize)
    }
}
