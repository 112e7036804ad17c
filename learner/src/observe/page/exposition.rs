//! The run's figures in OpenMetrics format for Prometheus. Each scrape reads the learner's current figures.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::{ConstCounter, Counter};
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::registry::Registry;

use super::RunView;
use super::memory::resident_bytes;
use super::view::Facts;
use crate::event::Stage;
use crate::slots::AuditCounts;
use crate::snapshot::RunSnapshot;

/// Content type of [`text`].
pub(super) const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Labels of one series.
type Labels = Vec<(&'static str, String)>;

/// All figures in OpenMetrics format.
pub(super) fn text(view: &RunView) -> String {
    let mut metrics = MetricSet(Registry::with_prefix("s2mia"));
    let (facts, run) = (&view.facts, view.exchange.run_snapshot());
    metrics.run(facts);
    metrics.progress(facts, &run);
    metrics.returns(view);
    metrics.work(&run);
    metrics.intake(&run);
    metrics.checkpoints(facts, &run);
    metrics.faults(&run);
    metrics.certificates(view);
    let mut process = MetricSet(Registry::with_prefix("process"));
    process.memory();
    let mut text = String::new();
    let written = prometheus_client::encoding::text::encode_registry(&mut text, &process.0);
    written.and_then(|()| encode(&mut text, &metrics.0)).expect("writing to a string cannot fail");
    text
}

/// The metrics under one prefix.
struct MetricSet(Registry);

impl MetricSet {
    fn run(&mut self, facts: &Facts) {
        let manifest = &facts.manifest;
        let text = |name| (name, manifest[name].as_str().unwrap_or_default().to_owned());
        let info = Family::<Labels, Gauge>::default();
        info.get_or_create(&["run_id", "task", "algorithm", "version"].map(text).into()).set(1);
        self.0.register("run_info", "Constants of the run; always 1", info);
    }

    fn progress(&mut self, facts: &Facts, run: &RunSnapshot) {
        let status = &run.status;
        self.counter("env_steps", "Environment steps of complete slots", status.env_steps);
        self.gauge("iteration", "Finished iterations", status.iteration as f64);
        let planned = facts.iterations as f64;
        self.gauge("iterations_planned", "Iterations of the whole run", planned);
        let help = "Uses of each environment step in the optimiser steps of an agent";
        self.gauge("sample_reuse_ratio", help, facts.sample_reuse);
        let at = |stage: Stage| (stage.name(), f64::from(u8::from(stage == run.stage)));
        self.gauges("phase", "1 for the current stage of the trainer", "phase", Stage::ALL.map(at));
        let secs = run.phase_secs().into_iter().flatten();
        self.gauges("phase_seconds", "Duration of the parts of the last iteration", "phase", secs);
    }

    fn returns(&mut self, view: &RunView) {
        for (name, help, figure) in [
            ("episode_return", "Mean return of the last training episodes", "episode_return"),
            ("evaluation_return", "Mean return of the last evaluation", "evaluation/mean"),
        ] {
            if let Some(value) = view.curves().newest(figure) {
                self.gauge(name, help, value);
            }
        }
    }

    /// Slots, actors and leases.
    fn work(&mut self, run: &RunSnapshot) {
        let status = &run.status;
        let (complete, leased) = (status.complete_slots, run.held_slots);
        let free = status.slots.saturating_sub(complete + leased);
        let slots = [("free", free), ("leased", leased), ("complete", complete)];
        let slots = slots.map(|(state, count)| (state, count as f64));
        self.gauges("slots", "Slots of the open iteration", "state", slots);
        let working = status.leases.iter().map(|lease| lease.actor).collect::<BTreeSet<_>>().len();
        let idle = status.actors.saturating_sub(working as u64);
        let actors = [("working", working as f64), ("idle", idle as f64)];
        self.gauges("actors", "Connected actors", "state", actors);
        let help = "Slots and episodes leased again";
        self.counter("leases_reissued", help, status.leases_reissued);
        let help = "Slots and episodes leased a second time because the first lease was slow";
        self.counter("slots_backed_up", help, status.slots_backed_up);
        let AuditCounts { agreed, disagreed, skipped } = run.audits;
        let audits = [("agreed", agreed), ("disagreed", disagreed), ("skipped", skipped)];
        let audits = audits.map(|(result, count)| (vec![("result", result.to_owned())], count));
        self.counters(
            "audits",
            "Slots and episodes computed again by another actor, by result",
            audits,
        );
        let still = status.leases.iter().map(|lease| lease.still_secs).fold(0.0, f64::max);
        self.gauge("lease_still_seconds", "Longest time of an open lease without progress", still);
        if let Some(secs) = run.slot_secs {
            let help = "Median time of the latest slots, for each environment of a slot";
            self.gauge("slot_seconds", help, secs);
        }
    }

    /// Messages received from actors.
    fn intake(&mut self, run: &RunSnapshot) {
        let chunks = [(vec![("result", "accepted".to_owned())], run.chunks_accepted)];
        self.counters("chunks", "Chunks of trajectories", chunks);
        let help = "Size of all received messages with results";
        self.counter("ingest_bytes", help, run.bytes_received);
        let help = "Steps that trajectory logs lost";
        self.counter("log_dropped", help, run.log_steps_lost);
        let refusals = run.refusals.iter();
        let refusals = refusals.map(|(reason, count)| (vec![("reason", reason.clone())], *count));
        self.counters("messages_refused", "Refused messages by reason", refusals);
        let help = "Actors without a fingerprint whose results count: with any, the run is not exactly repeatable";
        self.counter("foreign_actors", help, run.foreign_actors);
        self.gauge("weights_bytes", "Size of the newest weights", run.weights_bytes as f64);
    }

    fn checkpoints(&mut self, facts: &Facts, run: &RunSnapshot) {
        if let Some(written) = run.checkpoint {
            self.gauge(
                "checkpoint_seconds",
                "Duration of writing the last checkpoint",
                written.secs,
            );
            self.gauge("checkpoint_bytes", "Size of the last checkpoint", written.bytes as f64);
        }
        let newest = run.checkpoint.map_or(facts.resumed_at, |written| written.iteration);
        self.gauge("checkpoint_iteration", "Iteration of the last checkpoint", newest as f64);
        let help = "Iterations from one checkpoint to the next";
        self.gauge("checkpoint_every_iterations", help, facts.checkpoint_every as f64);
        let help = "Checkpoints that could not be written";
        self.counter("checkpoint_failures", help, run.checkpoint_failures);
    }

    fn faults(&mut self, run: &RunSnapshot) {
        let help = "Episodes truncated by a fault of their environment";
        self.counter("env_faults", help, run.environment_faults);
        let help = "Updates skipped because returns were not finite";
        self.counter("nonfinite_updates", help, run.updates_skipped);
    }

    /// Ends of validity; none without TLS.
    fn certificates(&mut self, view: &RunView) {
        let Some(tls) = &view.certificates else { return };
        let ends = [("learner", tls.expires()), ("clients", tls.clients_expire())];
        let ends = ends.into_iter().filter_map(|(of, at)| Some((of, at? as f64)));
        let help = "When the certificate of the learner, and the first one of its connected clients, expires";
        self.gauges("certificate_expiry_timestamp_seconds", help, "of", ends);
    }

    fn memory(&mut self) {
        if let Some(bytes) = resident_bytes() {
            self.gauge("resident_memory_bytes", "Resident memory of the learner", bytes as f64);
        }
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.0.register(name, help, ConstGauge::new(value));
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) {
        self.0.register(name, help, ConstCounter::new(value));
    }

    fn gauges(
        &mut self,
        name: &str,
        help: &str,
        label: &'static str,
        values: impl IntoIterator<Item = (&'static str, f64)>,
    ) {
        let family = Family::<Labels, Gauge<f64, AtomicU64>>::default();
        for (of, value) in values {
            family.get_or_create(&vec![(label, of.to_owned())]).set(value);
        }
        self.0.register(name, help, family);
    }

    fn counters(
        &mut self,
        name: &str,
        help: &str,
        values: impl IntoIterator<Item = (Labels, u64)>,
    ) {
        let family = Family::<Labels, Counter>::default();
        for (labels, value) in values {
            family.get_or_create(&labels).inc_by(value);
        }
        self.0.register(name, help, family);
    }
}
