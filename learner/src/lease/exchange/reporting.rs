//! The exchange's reports: it publishes the run's snapshot and whether checkpoints reach the disk.

use std::sync::Arc;
use std::time::Duration;

use proto::{EvaluationResult, Film, LeaseStatus, LeasedWork, PushHeader, RunEnd, RunLine, Status};
use serde_json::{Value, json};
use tokio::sync::watch;

use crate::lease::exchange::{Exchange, Shared};
use crate::lease::slots::Counts;
use crate::observe::event::{Event, Summary};
use crate::observe::snapshot::{FilmedEpisode, RunSnapshot};

/// Whether checkpoints reach the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// They do.
    Sound,
    /// The last checkpoint that was due could not be written.
    Degraded,
}

/// When the last iterations were opened.
#[derive(Debug, Default)]
pub(super) struct Pace {
    iteration: u64,
    opened: Option<Duration>,
    /// How long the iteration before the open one took.
    took: Option<Duration>,
}

impl Pace {
    pub(super) fn open(&mut self, iteration: u64, now: Duration) {
        self.took = self.opened.map(|before| now - before);
        self.opened = Some(now);
        self.iteration = iteration;
    }

    /// How long the open iteration has been open, seconds.
    pub(super) fn secs_open(&self, now: Duration) -> f64 {
        self.opened.map_or(0.0, |opened| (now - opened).as_secs_f64())
    }
}

impl Exchange {
    /// The run's figures now. Leases past their deadline end first.
    #[must_use]
    pub fn run_snapshot(&self) -> Arc<RunSnapshot> {
        // Measured and stored under the lock of the table, so that older figures never replace newer ones.
        self.change(|shared| self.change_quietly(|snapshot| self.measure(shared, snapshot)));
        Arc::clone(&self.snapshot.borrow())
    }

    /// The figures that the control service reports.
    #[must_use]
    pub fn status(&self) -> Status {
        self.run_snapshot().status.clone()
    }

    /// The snapshot as of the last event, and each later one.
    #[must_use]
    pub fn lines(&self) -> watch::Receiver<Arc<RunSnapshot>> {
        self.snapshot.subscribe()
    }

    /// Publishes what an event of the trainer changes.
    pub fn observe(&self, event: &Event) {
        self.snapshot.send_modify(|snapshot| Arc::make_mut(snapshot).observe(event));
    }

    /// Publishes the run's last line; `summary` is missing if the trainer failed.
    pub(crate) fn show_end(&self, summary: Option<&Summary>) {
        let status = self.status();
        let counted = status.iteration * self.iteration_steps(&self.lock().table.counts());
        let (iteration, env_steps) =
            summary.map_or((status.iteration, counted), |ended| (ended.iteration, ended.env_steps));
        let first = RunLine { run_id: status.run_id, iteration, env_steps, ..RunLine::default() };
        let end = match summary {
            Some(ended) if !ended.stopped_early => RunEnd::Finished,
            _ if self.is_stop_requested() => RunEnd::StoppedByClient,
            _ => RunEnd::Stopped,
        };
        self.snapshot.send_modify(|snapshot| Arc::make_mut(snapshot).end(end, first));
    }

    /// Keeps the film of an accepted episode for the page.
    pub fn keep_film(&self, header: &PushHeader, result: EvaluationResult, film: Film) {
        let version = header.weights.version;
        self.change_quietly(|snapshot| snapshot.show_film(FilmedEpisode { version, result, film }));
    }

    /// Counts the bytes of a message with results, valid or not.
    pub(crate) fn count_bytes(&self, bytes: usize) {
        self.change_quietly(|snapshot| snapshot.bytes_received += bytes as u64);
    }

    /// Counts steps that a log lost, an actor's or the learner's own. An actor may claim any number, so the sum
    /// saturates.
    pub(crate) fn count_lost_log_steps(&self, steps: u64) {
        self.change_quietly(|snapshot| {
            snapshot.log_steps_lost = snapshot.log_steps_lost.saturating_add(steps);
        });
    }

    /// Reports whether checkpoints reach the disk.
    pub(crate) fn report_storage(&self, storage: Storage) {
        self.storage.send_replace(storage);
    }

    /// Whether checkpoints reach the disk, now and whenever it changes.
    #[must_use]
    pub fn storage(&self) -> watch::Receiver<Storage> {
        self.storage.subscribe()
    }

    /// Changes figures without waking subscribers, who wait for events.
    fn change_quietly(&self, change: impl FnOnce(&mut RunSnapshot)) {
        self.snapshot.send_if_modified(|snapshot| {
            change(Arc::make_mut(snapshot));
            false
        });
    }

    /// Writes the figures of the slot table, the weights and the counters.
    fn measure(&self, shared: &Shared, snapshot: &mut RunSnapshot) {
        let counts = shared.table.counts();
        let pace = &shared.pace;
        let chunk_steps = u64::from(self.run.chunk_steps) * counts.environments_per_slot as u64;
        snapshot.steps_collected = counts.chunks * chunk_steps;
        snapshot.chunks_accepted = shared.chunks_accepted;
        snapshot.weights_bytes = shared.weights.newest_bytes();
        snapshot.foreign_actors = counts.foreign;
        snapshot.held_slots = counts.held_slots as u64;
        snapshot.audits = counts.audits;
        snapshot.slot_secs = counts.slot_time.map(|time| time.as_secs_f64());
        snapshot.refusals.clone_from(&shared.refusals);
        let (slots, complete_slots) = (counts.slots as u64, counts.complete_slots as u64);
        let iteration_steps = self.iteration_steps(&counts);
        let per_sec = |took: Duration| iteration_steps as f64 / took.as_secs_f64();
        let slot_steps = u64::from(self.run.slot_steps) * counts.environments_per_slot as u64;
        let status = &mut snapshot.status;
        status.iteration = shared.weights.newest().map_or(0, |version| version.0);
        status.env_steps = pace.iteration * iteration_steps + complete_slots * slot_steps;
        (status.slots, status.complete_slots) = (slots, complete_slots);
        status.actors = counts.actors as u64;
        status.env_steps_per_sec = pace.took.map(per_sec);
        status.messages_refused = shared.refusals.values().sum();
        status.leases_reissued = counts.reissued;
        status.storage_degraded = *self.storage.borrow() == Storage::Degraded;
        status.leases = shared.table.leases();
        status.slots_backed_up = counts.backups;
        status.audits_agreed = counts.audits.agreed;
    }

    /// Environment steps of one iteration, however its environments are cut into slots.
    fn iteration_steps(&self, counts: &Counts) -> u64 {
        u64::from(self.run.slot_steps) * counts.environments as u64
    }
}

/// A status as one JSON object.
#[must_use]
pub fn status_json(status: &Status) -> Value {
    let lease = |lease: &LeaseStatus| {
        let (slot, episode) = match lease.work {
            LeasedWork::Slot(slot) => (Some(slot), None),
            LeasedWork::Episode(episode) => (None, Some(episode)),
        };
        json!({
            "lease": lease.lease.0,
            "actor": lease.actor.0,
            "slot": slot,
            "episode": episode,
            "chunks": lease.chunks,
            "still_secs": lease.still_secs,
        })
    };
    let mut object = json!(status);
    object["state"] = "running".into();
    object["incarnation"] = format!("{:016x}", status.incarnation.0).into();
    object["leases"] = status.leases.iter().map(lease).collect();
    object
}
