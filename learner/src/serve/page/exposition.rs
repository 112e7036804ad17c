//! The run's figures in OpenMetrics format for Prometheus. Each scrape reads the learner's current figures.

use std::collections::BTreeSet;
use std::fmt::Display;

use super::{Facts, RunView};
use crate::observe::event::Stage;
use crate::observe::snapshot::{AuditCounts, RunSnapshot};

/// Content type of [`text`].
pub(super) const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// All figures in OpenMetrics format.
pub(super) fn text(view: &RunView) -> String {
    let mut metrics = Exposition(String::new());
    let facts = &view.facts;
    let run = view.exchange.run_snapshot();
    metrics.memory();
    metrics.run(facts);
    metrics.progress(facts, &run);
    metrics.returns(view);
    metrics.work(&run);
    metrics.intake(&run);
    metrics.checkpoints(facts, &run);
    metrics.faults(&run);
    metrics.0.push_str("# EOF\n");
    metrics.0
}

/// The lines so far.
struct Exposition(String);

impl Exposition {
    fn run(&mut self, facts: &Facts) {
        let label = |name| {
            let value = facts.shown.manifest[name].as_str().unwrap_or_default();
            format!("{name}=\"{}\"", escaped(value))
        };
        let labels = ["run_id", "task", "algorithm", "version"].map(label).join(",");
        self.family("gauge", "s2mia_run_info", "Constants of the run; always 1");
        self.sample(&format!("s2mia_run_info{{{labels}}}"), 1);
    }

    fn progress(&mut self, facts: &Facts, run: &RunSnapshot) {
        let status = &run.status;
        self.counter("env_steps", "Environment steps of complete slots", status.env_steps);
        self.gauge("iteration", "Finished iterations", status.iteration as f64);
        let planned = facts.shown.iterations as f64;
        self.gauge("iterations_planned", "Iterations of the whole run", planned);
        let help =
            "Uses of each environment step in the optimiser steps of an agent (HASAC: the critics)";
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
        let curves = view.curves();
        for (name, help, prefix) in [
            ("reward_term", "Mean of each reward term in a step of the last iteration", "reward/"),
            (
                "evaluation_return_term",
                "Mean of each reward term's sum in an episode of the last evaluation",
                "evaluation/return/",
            ),
        ] {
            let term = |(name, _)| Some((str::strip_prefix(name, prefix)?, curves.newest(name)?));
            self.gauges(name, help, "term", curves.iter().filter_map(term));
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
        let help = "Slots and episodes computed again by another actor, by result";
        self.counters("audits", help, "result", audits);
        let still = status.leases.iter().map(|lease| lease.still_secs).fold(0.0, f64::max);
        self.gauge("lease_still_seconds", "Longest time of an open lease without progress", still);
        if let Some(secs) = run.slot_secs {
            let help = "Median time of the latest slots, for each environment of a slot";
            self.gauge("slot_seconds", help, secs);
        }
    }

    /// Messages received from actors.
    fn intake(&mut self, run: &RunSnapshot) {
        let chunks = [("accepted", run.chunks_accepted)];
        self.counters("chunks", "Chunks of trajectories", "result", chunks);
        let help = "Size of all received messages with results";
        self.counter("ingest_bytes", help, run.bytes_received);
        let help = "Steps that trajectory logs lost";
        self.counter("log_dropped", help, run.log_steps_lost);
        let refusals = run.refusals.iter().map(|(reason, count)| (reason.as_str(), *count));
        self.counters("messages_refused", "Refused messages by reason", "reason", refusals);
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

    fn memory(&mut self) {
        if let Some(bytes) = resident_bytes() {
            let name = "process_resident_memory_bytes";
            self.family("gauge", name, "Resident memory of the learner");
            self.sample(name, bytes);
        }
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        let name = format!("s2mia_{name}");
        self.family("gauge", &name, help);
        self.sample(&name, value);
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) {
        let name = format!("s2mia_{name}");
        self.family("counter", &name, help);
        self.sample(&format!("{name}_total"), value);
    }

    fn gauges<'a>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        values: impl IntoIterator<Item = (&'a str, f64)>,
    ) {
        self.labelled(("gauge", ""), (name, help), label, values);
    }

    fn counters<'a>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        values: impl IntoIterator<Item = (&'a str, u64)>,
    ) {
        self.labelled(("counter", "_total"), (name, help), label, values);
    }

    /// A metric with a sample for each value of a label.
    fn labelled<'a>(
        &mut self,
        (kind, suffix): (&str, &str),
        (name, help): (&str, &str),
        label: &str,
        values: impl IntoIterator<Item = (&'a str, impl Display)>,
    ) {
        let name = format!("s2mia_{name}");
        self.family(kind, &name, help);
        for (of, value) in values {
            self.sample(&format!("{name}{suffix}{{{label}=\"{}\"}}", escaped(of)), value);
        }
    }

    /// The lines that precede the samples of a metric.
    fn family(&mut self, kind: &str, name: &str, help: &str) {
        self.0.push_str(&format!("# HELP {name} {help}.\n# TYPE {name} {kind}\n"));
    }

    fn sample(&mut self, series: &str, value: impl Display) {
        self.0.push_str(&format!("{series} {value}\n"));
    }
}

/// The value of a label.
fn escaped(value: &str) -> String {
    value.replace('\\', r"\\").replace('"', "\\\"").replace('\n', r"\n")
}

/// Resident memory of this process, bytes; `None` without `/proc`.
fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_have_the_form_of_open_metrics() {
        let mut metrics = Exposition(String::new());
        metrics.gauge("iteration", "Finished iterations", 3.0);
        metrics.counters("chunks", "Chunks", "result", [("a \"b\"\\\n", 4)]);
        let expected = r#"# HELP s2mia_iteration Finished iterations.
# TYPE s2mia_iteration gauge
s2mia_iteration 3
# HELP s2mia_chunks Chunks.
# TYPE s2mia_chunks counter
s2mia_chunks_total{result="a \"b\"\\\n"} 4
"#;
        assert_eq!(metrics.0, expected);
    }
}
