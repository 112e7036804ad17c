//! Work that actors returned because they could not process it: who may try it again, and when it is given up.
//!
//! After its first failure, work is leased to other processes first. One actor alone can therefore neither block work nor
//! end the run while another actor can do the work.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use proto::LeaseFailure;

use super::actors::Process;
use super::works::{Group, Key};

/// Processes that cannot restore a slot's start states, or leases of the only one, after which it begins new episodes.
const MOST_START_STATES: u32 = 2;
/// Failed leases of a slot that continues episodes after which it begins new ones.
const MOST_CONTINUED: u32 = 4;
/// Failed leases of a new episode after which the run ends.
const MOST_FRESH: u32 = 5;
/// Processes remembered for each work; a client may invent any number.
const MOST_PROCESSES: usize = 64;

/// Failed work of the open iteration and of open evaluations.
#[derive(Debug)]
pub(super) struct Failures {
    /// A lease's time to live.
    ttl: Duration,
    works: BTreeMap<Key, Failed>,
}

/// What happens to failed work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It is leased again.
    Retry,
    /// The slot waits until the trainer has replaced its start states.
    BeginAgain,
    /// It failed this many times and ends the run.
    GiveUp(u32),
}

/// How the work starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Begin {
    /// With new episodes only.
    Fresh,
    /// With at least one state of an earlier slot.
    Continued,
}

#[derive(Debug, Default)]
struct Failed {
    times: u32,
    start_states: u32,
    /// Processes that could not restore the start states.
    unrestored_by: BTreeSet<Process>,
    by: BTreeSet<Process>,
    /// When a failure counted first.
    first: Option<Duration>,
    last: Duration,
    /// Time after the last failure in which no process may try.
    wait: Duration,
    /// The trainer replaces the work, or the run ends: it is not leased.
    decided: bool,
}

impl Failures {
    pub(super) fn new(ttl: Duration) -> Self {
        Self { ttl, works: BTreeMap::new() }
    }

    /// Whether `process` may try the work now. No process may while the work waits; one that failed waits for the `others`,
    /// the registered processes, but not longer than a time to live.
    pub(super) fn may_try(
        &self,
        key: Key,
        process: Process,
        others: impl Iterator<Item = Process>,
        now: Duration,
    ) -> bool {
        let Some(failed) = self.works.get(&key) else { return true };
        if now < failed.last + failed.wait {
            return false;
        }
        let waits = || failed.is_untried_by(others) && now < failed.last + self.ttl;
        !(failed.decided || failed.is_by(process) && waits())
    }

    /// Whether `process` may compute work that another lease computes too. One that failed may not for a time to
    /// live, or at all if the work failed often: the other lease ends it then.
    pub(super) fn may_back_up(&self, key: Key, process: Process, now: Duration) -> bool {
        let Some(failed) = self.works.get(&key) else { return true };
        !failed.is_by(process) || failed.times < MOST_CONTINUED && now >= failed.last + self.ttl
    }

    /// `process` failed at work that another lease still computes: only a second failure counts, and nothing follows yet.
    pub(super) fn note(&mut self, key: Key, process: Process, now: Duration) {
        let failed = self.works.entry(key).or_default();
        failed.times += u32::from(failed.is_by(process));
        failed.wait = Duration::ZERO;
        failed.add(process, now);
    }

    /// When work that waits, for a time or for processes that have not tried it, is next free for more processes.
    pub(super) fn next_try(&self, now: Duration) -> Option<Duration> {
        let undecided = self.works.values().filter(|failed| !failed.decided);
        let free = |failed: &Failed| [failed.last + failed.wait, failed.last + self.ttl];
        undecided.flat_map(free).filter(|at| *at > now).min()
    }

    /// Counts a failure. `others` are the registered processes.
    pub(super) fn add(
        &mut self,
        (key, begin): (Key, Begin),
        failure: LeaseFailure,
        process: Process,
        others: impl Iterator<Item = Process>,
        now: Duration,
    ) -> Verdict {
        let failed = self.works.entry(key).or_default();
        failed.times += 1;
        if failure == LeaseFailure::StartState {
            failed.start_states += 1;
            failed.unrestored_by.insert(process);
        }
        failed.add(process, now);
        let first = *failed.first.get_or_insert(now);
        let most = if begin == Begin::Fresh { MOST_FRESH } else { MOST_CONTINUED };
        let tried_by_all = !failed.is_untried_by(others) || now >= first + self.ttl * most;
        // Episodes are not given up for a short outage of their environment. The other processes wait, too, because they may
        // share it. A new episode does not wait: a run that ends can be resumed, and is the same then.
        failed.wait = match (begin, failure) {
            (Begin::Continued, LeaseFailure::Environment) => {
                self.ttl * (failed.times - 1).min(MOST_CONTINUED) / MOST_CONTINUED
            }
            _ => Duration::ZERO,
        };
        let verdict = match begin {
            _ if failed.decided => Verdict::Retry,
            Begin::Continued
                if failed.unrestored_by.len() >= MOST_START_STATES as usize
                    || tried_by_all && failed.start_states >= MOST_START_STATES =>
            {
                Verdict::BeginAgain
            }
            Begin::Continued if failed.times >= most && tried_by_all => Verdict::BeginAgain,
            Begin::Fresh if failed.times >= most && tried_by_all => Verdict::GiveUp(failed.times),
            _ => Verdict::Retry,
        };
        failed.decided |= verdict != Verdict::Retry;
        verdict
    }

    /// The work is done, or has other start states.
    pub(super) fn forget(&mut self, key: Key) {
        self.works.remove(&key);
    }

    /// Another iteration has been opened.
    pub(super) fn forget_slots(&mut self) {
        self.works.retain(|key, _| key.group != Group::Slots);
    }
}

impl Failed {
    /// Whether the process failed, as far as it is known.
    fn is_by(&self, process: Process) -> bool {
        self.by.contains(&process) || self.by.len() >= MOST_PROCESSES
    }

    fn add(&mut self, process: Process, now: Duration) {
        self.last = now;
        if self.by.len() < MOST_PROCESSES {
            self.by.insert(process);
        }
    }

    fn is_untried_by(&self, mut others: impl Iterator<Item = Process>) -> bool {
        others.any(|other| !self.by.contains(&other))
    }
}
