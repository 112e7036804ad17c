//! The state of each actor process: its actors, how much work it lost in a row, and whether it waits for work.

use std::collections::BTreeMap;
use std::time::Duration;

use super::Trust;
use super::actors::Process;

/// Leases in a row that a process lost before it counts as stalled. A slow process ends a lease now and then, and counts
/// again from zero.
const STALLED: u32 = 3;
/// Free work is kept this long for a process that waits. One that still waits asks again as soon as work is free.
const KEPT: Duration = Duration::from_secs(1);
/// A process without a lease that has not requested work for this long is inactive. No actor waits as long for one answer.
const SILENCE: Duration = Duration::from_secs(60);

/// The processes that have a registered actor.
#[derive(Debug, Default)]
pub(super) struct Processes {
    known: BTreeMap<Process, Known>,
    waiting: BTreeMap<Process, Waiting>,
    /// How many of the processes are stalled.
    stalled: usize,
}

#[derive(Debug, Default)]
struct Known {
    actors: usize,
    exact: usize,
    /// When it last registered or asked for work.
    seen: Duration,
    /// Leases that ended without a result since the last one with a result.
    lost: u32,
}

/// A process without a lease that requested work and got none.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    /// It is gone if it has not asked again by then.
    until: Duration,
    /// Since when work is kept for it.
    kept: Option<Duration>,
}

impl Processes {
    pub(super) fn join(&mut self, process: Process, trust: Trust, now: Duration) {
        let known = self.known.entry(process).or_default();
        known.actors += 1;
        known.seen = now;
        known.exact += usize::from(trust == Trust::Exact);
    }

    pub(super) fn leave(&mut self, process: Process, trust: Trust) {
        let Some(known) = self.known.get_mut(&process) else { return };
        known.actors -= 1;
        known.exact -= usize::from(trust == Trust::Exact);
        if known.actors == 0 {
            self.stalled -= usize::from(known.lost >= STALLED);
            self.known.remove(&process);
            self.waiting.remove(&process);
        }
    }

    /// The processes with a registered actor of this trust or more.
    pub(super) fn registered(&self, least: Trust) -> impl Iterator<Item = Process> {
        let suits = move |known: &Known| least == Trust::Foreign || known.exact > 0;
        self.known.iter().filter(move |(_, known)| suits(known)).map(|(process, _)| *process)
    }

    /// Whether the exact actors of another process may soon audit what `process` computed: one that is not stalled, and
    /// that requested work recently or `holds` a lease.
    pub(super) fn can_audit_soon(
        &self,
        process: Process,
        now: Duration,
        holds: impl Fn(Process) -> bool,
    ) -> bool {
        let mut others = self.known.iter().filter(|(other, _)| **other != process);
        others.any(|(other, known)| {
            let is_active = known.seen + SILENCE > now || holds(*other);
            known.exact > 0 && known.lost < STALLED && is_active
        })
    }

    /// Whether there are other processes with exact actors, and all of them are stalled.
    pub(super) fn others_are_stalled(&self, process: Process) -> bool {
        let others = self.known.iter().filter(|(other, _)| **other != process);
        let mut lost = others.filter(|(_, known)| known.exact > 0).map(|(_, known)| known.lost);
        lost.next().is_some_and(|first| first >= STALLED) && lost.all(|lost| lost >= STALLED)
    }

    /// The process asks for work.
    pub(super) fn note_request(&mut self, process: Process, now: Duration) {
        if let Some(known) = self.known.get_mut(&process) {
            known.seen = now;
        }
    }

    /// A lease of the process ended without a result.
    pub(super) fn lost(&mut self, process: Process) {
        if let Some(known) = self.known.get_mut(&process) {
            known.lost = known.lost.saturating_add(1);
            self.stalled += usize::from(known.lost == STALLED);
        }
    }

    /// A lease of the process ended with its result.
    pub(super) fn finished(&mut self, process: Process) {
        if let Some(known) = self.known.get_mut(&process) {
            self.stalled -= usize::from(known.lost >= STALLED);
            known.lost = 0;
        }
    }

    /// Whether the process lost its latest leases.
    pub(super) fn is_stalled(&self, process: Process) -> bool {
        self.known.get(&process).is_some_and(|known| known.lost >= STALLED)
    }

    /// Whether any process is stalled.
    pub(super) fn any_stalled(&self) -> bool {
        self.stalled > 0
    }

    /// The process, which holds no lease, requested work and got none.
    pub(super) fn wait(&mut self, process: Process, now: Duration) {
        self.waiting.insert(process, Waiting { until: now + SILENCE, kept: None });
    }

    /// The process got work, or may not have the free work. Whether work that was kept is free for the others now, because
    /// no other process waits.
    pub(super) fn stop_waiting(&mut self, process: Process) -> bool {
        let was_kept = |one: Waiting| one.kept.is_some();
        self.waiting.remove(&process).is_some_and(was_kept) && self.waiting.is_empty()
    }

    /// How many processes wait, `process` aside. Those that do not take the work that was kept for them no longer do.
    pub(super) fn others_waiting(&mut self, process: Process, now: Duration) -> usize {
        let missed = |since: Duration| since + KEPT <= now;
        self.waiting.retain(|_, one| one.until > now && !one.kept.is_some_and(missed));
        self.waiting.len() - usize::from(self.waiting.contains_key(&process))
    }

    /// Work was refused to another process, to keep it for those that wait.
    pub(super) fn reserve_free_work(&mut self, now: Duration) {
        self.waiting.values_mut().for_each(|one| one.kept = one.kept.or(Some(now)));
    }

    /// When the first work that is kept for a process is free for the others, if not yet.
    pub(super) fn first_released(&self, now: Duration) -> Option<Duration> {
        let released = self.waiting.values().filter_map(|one| one.kept).map(|since| since + KEPT);
        released.filter(|at| *at > now).min()
    }
}
