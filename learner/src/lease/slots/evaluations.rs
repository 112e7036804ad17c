//! Open evaluations and their episodes.

use std::collections::{BTreeMap, BTreeSet};

use proto::{EvaluationResult, EvaluationWork, WeightsName};

use super::EvaluationOutcome;

/// Open evaluations by iteration.
#[derive(Debug, Default)]
pub(super) struct Evaluations(BTreeMap<u64, Evaluation>);

#[derive(Debug)]
struct Evaluation {
    weights: WeightsName,
    episodes: Vec<Episode>,
    /// Episodes without a lease or a result.
    free: BTreeSet<u32>,
    /// Episodes without a result.
    missing: usize,
}

#[derive(Clone, Debug, Default)]
struct Episode {
    issued: u32,
    result: Option<EvaluationResult>,
}

impl Evaluations {
    pub(super) fn open(&mut self, iteration: u64, weights: WeightsName, episodes: u32) {
        let (free, missing) = ((0..episodes).collect(), episodes as usize);
        let episodes = vec![Episode::default(); missing];
        self.0.insert(iteration, Evaluation { weights, episodes, free, missing });
    }

    pub(super) fn weights(&self) -> impl Iterator<Item = WeightsName> {
        self.0.values().map(|evaluation| evaluation.weights)
    }

    /// The first free episode of the earliest evaluation that `may_try` permits, and how often it was leased before.
    pub(super) fn claim(
        &mut self,
        may_try: impl Fn(EvaluationWork) -> bool,
    ) -> Option<(EvaluationWork, WeightsName, u32)> {
        for (iteration, evaluation) in &mut self.0 {
            let work = |at: u32| EvaluationWork { iteration: *iteration, episode: at };
            let first = evaluation.free.iter().copied().find(|at| may_try(work(*at)));
            if let Some(at) = first {
                evaluation.free.remove(&at);
                let episode = &mut evaluation.episodes[at as usize];
                episode.issued += 1;
                return Some((work(at), evaluation.weights, episode.issued - 1));
            }
        }
        None
    }

    pub(super) fn release(&mut self, work: EvaluationWork) {
        if let Some(evaluation) = self.0.get_mut(&work.iteration)
            && let Some(Episode { result: None, .. }) =
                evaluation.episodes.get(work.episode as usize)
        {
            evaluation.free.insert(work.episode);
        }
    }

    /// Takes the result in; the outcome if it was the evaluation's last one.
    pub(super) fn complete(
        &mut self,
        work: EvaluationWork,
        result: EvaluationResult,
    ) -> Option<EvaluationOutcome> {
        let evaluation = self.0.get_mut(&work.iteration)?;
        let episode = evaluation.episodes.get_mut(work.episode as usize)?;
        if episode.result.replace(result).is_none() {
            evaluation.missing -= 1;
        }
        evaluation.free.remove(&work.episode);
        if evaluation.missing > 0 {
            return None;
        }
        let episodes = self.0.remove(&work.iteration)?.episodes;
        let episodes = episodes.iter().map(|episode| episode.result).collect::<Option<_>>()?;
        Some(EvaluationOutcome { iteration: work.iteration, episodes })
    }
}

#[cfg(test)]
mod tests {
    use proto::{Digest, PolicyVersion};

    use super::*;

    #[test]
    fn only_an_episode_that_exists_and_has_no_result_becomes_free_again() {
        let mut evaluations = Evaluations::default();
        evaluations.open(3, WeightsName { version: PolicyVersion(3), digest: Digest([0; 32]) }, 2);
        let work = |episode| EvaluationWork { iteration: 3, episode };
        for episode in 0..2 {
            assert_eq!(evaluations.claim(|_| true).map(|(work, ..)| work), Some(work(episode)));
        }
        let result = EvaluationResult { episode: 0, extrinsic_return: 1.0, steps: 5 };
        assert_eq!(evaluations.complete(work(0), result), None);
        (0..3).for_each(|episode| evaluations.release(work(episode)));
        assert_eq!(evaluations.claim(|_| true).map(|(work, ..)| work), Some(work(1)));
        assert_eq!(evaluations.claim(|_| true).map(|(work, ..)| work), None);
    }
}
