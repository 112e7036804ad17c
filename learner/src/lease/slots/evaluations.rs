//! Open evaluations and their episodes. A slow episode gets a backup lease. One that is audited is played by two processes
//! before its evaluation is complete.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use proto::{Digest, EvaluationResult, EvaluationWork, LeaseId, WeightsName};

use super::EvaluationOutcome;
use super::actors::{Owner, Process};
use super::disagreement::{ComputedPart, Disagreement, Part};
use super::iteration::HeldLease;

/// Open evaluations by iteration.
#[derive(Debug, Default)]
pub(super) struct Evaluations(BTreeMap<u64, Evaluation>);

#[derive(Debug)]
struct Evaluation {
    weights: WeightsName,
    episodes: Vec<Episode>,
    /// Episodes without a lease or a result.
    free: BTreeSet<u32>,
    /// Episodes without a result, or with one that is audited.
    missing: usize,
}

#[derive(Clone, Debug, Default)]
struct Episode {
    issued: u32,
    /// The leases that play it, the oldest first; two if the first one is slow.
    held: Vec<HeldLease>,
    played: Option<Played>,
}

/// The first result of an episode.
#[derive(Clone, Copy, Debug)]
pub(super) struct Played {
    pub(super) result: EvaluationResult,
    pub(super) digest: Digest,
    pub(super) owner: Owner,
    pub(super) lease: LeaseId,
    /// The audit that the evaluation waits for, if any.
    pub(super) audit: Option<EpisodeAudit>,
}

/// An episode that another process plays again.
#[derive(Clone, Copy, Debug)]
pub(super) struct EpisodeAudit {
    pub(super) since: Duration,
    /// The result counts without the audit from then on.
    pub(super) until: Duration,
    pub(super) holder: Option<LeaseId>,
}

/// What a result of an episode is.
#[derive(Debug, PartialEq)]
pub(super) enum Verdict {
    /// The first one.
    First,
    /// It equals the first one.
    Agreed,
    /// It differs from the first one.
    Differed(Disagreement),
}

/// An episode to be leased, its policies, and how often it was leased before.
pub(super) type ClaimedEpisode = (EvaluationWork, WeightsName, u32);

impl Evaluations {
    pub(super) fn open(&mut self, iteration: u64, weights: WeightsName, episodes: u32) {
        let (free, missing) = ((0..episodes).collect(), episodes as usize);
        let episodes = vec![Episode::default(); missing];
        self.0.insert(iteration, Evaluation { weights, episodes, free, missing });
    }

    pub(super) fn weights(&self) -> impl Iterator<Item = WeightsName> {
        self.0.values().map(|evaluation| evaluation.weights)
    }

    /// Episodes of all open evaluations without a result, or with one that is audited.
    pub(super) fn missing(&self) -> usize {
        self.0.values().map(|evaluation| evaluation.missing).sum()
    }

    /// Whether an episode is free.
    pub(super) fn any_free(&self) -> bool {
        self.0.values().any(|evaluation| !evaluation.free.is_empty())
    }

    /// Leases the first free episode of the earliest evaluation that `may_try` permits to `id`.
    pub(super) fn claim(
        &mut self,
        id: LeaseId,
        now: Duration,
        may_try: impl Fn(EvaluationWork) -> bool,
    ) -> Option<ClaimedEpisode> {
        let free = |(iteration, evaluation): (&u64, &Evaluation)| {
            let work = |at: &u32| EvaluationWork { iteration: *iteration, episode: *at };
            evaluation.free.iter().map(work).find(|work| may_try(*work))
        };
        let work = self.0.iter().find_map(free)?;
        self.0.get_mut(&work.iteration)?.free.remove(&work.episode);
        self.issue(work, |episode| episode.held.push(HeldLease { id, since: now }))
    }

    /// Whether the episode has a result.
    pub(super) fn is_played(&self, work: EvaluationWork) -> bool {
        let episode = |open: &Evaluation| open.episodes.get(work.episode as usize)?.played;
        self.0.get(&work.iteration).is_some_and(|open| episode(open).is_some())
    }

    /// Leases to `id` the first episode without a result that `may_be_backed_up`, given its leases and their number so
    /// far. This lease begins `now`. A second one that the episode has already is replaced; it is returned.
    pub(super) fn claim_backup(
        &mut self,
        id: LeaseId,
        now: Duration,
        may_be_backed_up: impl Fn(EvaluationWork, &[HeldLease], u32) -> bool,
    ) -> Option<(ClaimedEpisode, Option<LeaseId>)> {
        let slow = |work, one: &Episode| {
            !one.held.is_empty() && may_be_backed_up(work, &one.held, one.issued)
        };
        let work = self.first(slow)?;
        let mut replaced = Vec::new();
        let claimed = self.issue(work, |episode| {
            replaced = episode.held.split_off(1);
            episode.held.push(HeldLease { id, since: now });
        })?;
        Some((claimed, replaced.first().map(|lease| lease.id)))
    }

    /// Leases to `id` the first audit without a lease that began at `latest` or before, of an episode that another process
    /// played.
    pub(super) fn claim_audit(
        &mut self,
        id: LeaseId,
        by: Owner,
        latest: Duration,
    ) -> Option<ClaimedEpisode> {
        let waits = |_, episode: &Episode| {
            episode.played.is_some_and(|played| {
                let waits = |audit: EpisodeAudit| audit.holder.is_none() && audit.since <= latest;
                played.audit.is_some_and(waits) && !played.owner.shares_process(&by)
            })
        };
        let work = self.first(waits)?;
        self.issue(work, |episode| set_holder(episode, Some(id)))
    }

    /// The begin of the latest lease of each episode that has one and no result.
    pub(super) fn latest_begins(&self) -> impl Iterator<Item = Duration> {
        let episodes = self.0.values().flat_map(|evaluation| &evaluation.episodes);
        episodes.filter_map(|episode| episode.held.last().map(|lease| lease.since))
    }

    fn first(&self, suits: impl Fn(EvaluationWork, &Episode) -> bool) -> Option<EvaluationWork> {
        self.0.iter().find_map(|(iteration, evaluation)| {
            let work = |at: u32| EvaluationWork { iteration: *iteration, episode: at };
            let mut works = (0..).map(work).zip(&evaluation.episodes);
            works.find(|(work, episode)| suits(*work, episode)).map(|(work, _)| work)
        })
    }

    fn issue(
        &mut self,
        work: EvaluationWork,
        lease: impl FnOnce(&mut Episode),
    ) -> Option<ClaimedEpisode> {
        let weights = self.0.get(&work.iteration)?.weights;
        let episode = self.episode(work)?;
        lease(episode);
        episode.issued += 1;
        Some((work, weights, episode.issued - 1))
    }

    fn episode(&mut self, work: EvaluationWork) -> Option<&mut Episode> {
        self.0.get_mut(&work.iteration)?.episodes.get_mut(work.episode as usize)
    }

    /// The lease ended without a result.
    pub(super) fn release(&mut self, work: EvaluationWork, id: LeaseId) {
        let Some(episode) = self.episode(work) else { return };
        episode.held.retain(|lease| lease.id != id);
        let audit = episode.played.and_then(|played| played.audit);
        if audit.is_some_and(|audit| audit.holder == Some(id)) {
            set_holder(episode, None);
        }
        if episode.held.is_empty()
            && episode.played.is_none()
            && let Some(evaluation) = self.0.get_mut(&work.iteration)
        {
            evaluation.free.insert(work.episode);
        }
    }

    /// The other leases that play the episode for its first result, besides `id`.
    pub(super) fn other_leases(&mut self, work: EvaluationWork, id: LeaseId) -> Vec<LeaseId> {
        let held = self.episode(work).map(|episode| episode.held.clone()).unwrap_or_default();
        held.iter().map(|lease| lease.id).filter(|other| *other != id).collect()
    }

    /// Takes a result in. Other leases of the episode have ended.
    pub(super) fn complete(&mut self, work: EvaluationWork, played: Played) -> Verdict {
        let Some(evaluation) = self.0.get_mut(&work.iteration) else { return Verdict::First };
        let Some(episode) = evaluation.episodes.get_mut(work.episode as usize) else {
            return Verdict::First;
        };
        episode.held.clear();
        evaluation.free.remove(&work.episode);
        let Some(first) = &mut episode.played else {
            episode.played = Some(played);
            evaluation.missing -= usize::from(played.audit.is_none());
            return Verdict::First;
        };
        if first.digest != played.digest {
            return Verdict::Differed(Disagreement {
                iteration: work.iteration,
                part: Part::Episode(work.episode),
                first: first.computed(),
                second: played.computed(),
            });
        }
        evaluation.missing -= usize::from(first.audit.take().is_some());
        Verdict::Agreed
    }

    /// Ends the audit that `id` computes. Whether there was one.
    pub(super) fn skip_audit(&mut self, work: EvaluationWork, id: LeaseId) -> bool {
        let Some(evaluation) = self.0.get_mut(&work.iteration) else { return false };
        let episode = evaluation.episodes.get_mut(work.episode as usize);
        let played = episode.and_then(|episode| episode.played.as_mut());
        let audit =
            played.and_then(|played| played.audit.take_if(|audit| audit.holder == Some(id)));
        evaluation.missing -= usize::from(audit.is_some());
        audit.is_some()
    }

    /// Ends the audits for which there is no more time, and those without a lease that are `hopeless` because of the
    /// process that played the episode. Returns their leases.
    pub(super) fn skip_audits(
        &mut self,
        now: Duration,
        hopeless: impl Fn(Process) -> bool,
    ) -> Vec<Option<LeaseId>> {
        let mut skipped = Vec::new();
        for evaluation in self.0.values_mut() {
            for played in evaluation.episodes.iter_mut().filter_map(|one| one.played.as_mut()) {
                let process = played.owner.process;
                let over = |audit: &EpisodeAudit| {
                    audit.until <= now || audit.holder.is_none() && hopeless(process)
                };
                if let Some(audit) = played.audit.take_if(|audit| over(audit)) {
                    evaluation.missing -= 1;
                    skipped.push(audit.holder);
                }
            }
        }
        skipped
    }

    /// When the first audit is skipped, if no result comes.
    pub(super) fn first_skipped(&self) -> Option<Duration> {
        let episodes = self.0.values().flat_map(|evaluation| &evaluation.episodes);
        episodes.filter_map(|episode| Some(episode.played?.audit?.until)).min()
    }

    /// The complete evaluations, which are no longer open.
    pub(super) fn take_complete(&mut self) -> Vec<EvaluationOutcome> {
        let complete = self.0.extract_if(.., |_, evaluation| evaluation.missing == 0);
        let outcome = |(iteration, evaluation): (u64, Evaluation)| {
            let played = evaluation.episodes.iter().filter_map(|episode| episode.played);
            let episodes = played.map(|played| played.result).collect();
            EvaluationOutcome { iteration, episodes }
        };
        complete.map(outcome).collect()
    }
}

impl Played {
    fn computed(&self) -> ComputedPart {
        let Self { digest, owner, lease, .. } = *self;
        ComputedPart { actor: owner.actor, lease, digest }
    }
}

fn set_holder(episode: &mut Episode, holder: Option<LeaseId>) {
    if let Some(audit) = episode.played.as_mut().and_then(|played| played.audit.as_mut()) {
        audit.holder = holder;
    }
}

#[cfg(test)]
mod tests {
    use proto::{ActorId, PolicyVersion};

    use super::super::{ConnectionId, Trust};
    use super::*;

    #[test]
    fn only_an_episode_that_exists_and_has_no_result_becomes_free_again() {
        let mut evaluations = Evaluations::default();
        evaluations.open(3, WeightsName { version: PolicyVersion(3), digest: Digest([0; 32]) }, 2);
        let work = |episode| EvaluationWork { iteration: 3, episode };
        let mut claim = |id| {
            let claimed = evaluations.claim(LeaseId(id), Duration::ZERO, |_| true);
            claimed.map(|(work, ..)| work)
        };
        assert_eq!([claim(1), claim(2), claim(3)], [Some(work(0)), Some(work(1)), None]);
        let connection = ConnectionId(1);
        let (process, trust) = (Process::Connection(connection), Trust::Exact);
        let owner = Owner { actor: ActorId(1), connection, process, trust };
        let result = EvaluationResult { episode: 0, extrinsic_return: 1.0, steps: 5 };
        let (digest, lease) = (result.digest(3), LeaseId(1));
        let played = Played { result, digest, owner, lease, audit: None };
        assert_eq!(evaluations.complete(work(0), played), Verdict::First);
        (0..3).for_each(|episode| evaluations.release(work(episode), LeaseId(2)));
        let mut claim =
            || evaluations.claim(LeaseId(4), Duration::ZERO, |_| true).map(|(work, ..)| work);
        assert_eq!([claim(), claim()], [Some(work(1)), None]);
    }
}
