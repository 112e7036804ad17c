//! The runs that this process has not started, and those that other processes hold.

use std::collections::{BTreeMap, VecDeque};

use super::claim::{Attempt, Claim, Claimant, Sighting};
use super::plan::PlannedRun;
use super::run_state::is_finished;

/// The runs in their order, without the started ones.
pub(crate) struct Queue {
    claimant: Claimant,
    waiting: VecDeque<(PlannedRun, Option<Sighting>)>,
    held: Vec<(PlannedRun, String)>,
    /// Runs that were finished when their turn came.
    pub(crate) finished: usize,
}

impl Queue {
    /// All `runs` wait.
    pub(crate) fn new(runs: &[PlannedRun]) -> Self {
        let waiting = runs.iter().map(|run| (run.clone(), None)).collect();
        Self { claimant: Claimant::of_this_host(), waiting, held: Vec::new(), finished: 0 }
    }

    /// The next run that this process can claim, or that it cannot claim because of an error. `None` if there is none,
    /// or if the claims that are left are unclear yet.
    pub(crate) async fn next(&mut self) -> Option<(PlannedRun, anyhow::Result<Claim>)> {
        for _ in 0..self.waiting.len() {
            let Some((run, seen)) = self.waiting.pop_front() else { break };
            if is_finished(&run) {
                self.finished += 1;
                continue;
            }
            match self.claimant.claim(&run.claim(), seen).await {
                // Its holder may have finished it since.
                Ok(Attempt::Claimed(_)) if is_finished(&run) => self.finished += 1,
                Ok(Attempt::Claimed(claim)) => return Some((run, Ok(claim))),
                Ok(Attempt::Held(holder)) => self.held.push((run, holder.host_name())),
                Ok(Attempt::Unclear(seen)) => self.waiting.push_back((run, Some(seen))),
                Err(error) => return Some((run, Err(error))),
            }
        }
        None
    }

    /// Whether no run waits.
    pub(crate) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Adds a run that another process took over.
    pub(crate) fn lost(&mut self, run: PlannedRun, host: String) {
        self.held.push((run, host));
    }

    /// Lets the runs of other processes wait again, because their holders may have ended.
    pub(crate) fn retry_held(&mut self) {
        self.waiting.extend(self.held.drain(..).map(|(run, _)| (run, None)));
    }

    /// Numbers of runs that other processes hold, by host.
    pub(crate) fn held(&self) -> BTreeMap<String, usize> {
        let mut hosts = BTreeMap::new();
        for (_, host) in &self.held {
            *hosts.entry(host.clone()).or_default() += 1;
        }
        hosts
    }
}
