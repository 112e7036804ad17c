//! `metrics.jsonl`: one line per iteration and one per evaluation, each exactly once.
//!
//! `iteration` is the number of finished iterations: in the line of an iteration, including that one; in the line of an
//! evaluation, that of the evaluated policies. If enabled, `metrics.csv`, `evaluations.csv` and `tensorboard/` contain
//! the same figures.

mod curves;
mod event_file;
mod restore;
mod table;
mod tags;
mod view;
mod views;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use serde_json::{Map, Value, json};

pub use self::curves::{Curve, Curves};
use self::views::Views;
use crate::config::MetricsConfig;
use crate::durable::FileError;
use crate::evaluation::Spread;
use crate::event::IterationReport;
use crate::json_lines::{JsonLines, iterations};

/// The file's name in the run folder.
pub const METRICS_FILE: &str = "metrics.jsonl";

/// The tables beside it, and the lines that each holds.
const TABLES: [(&str, &str); 2] = [("metrics.csv", "iteration"), ("evaluations.csv", "evaluation")];

/// The metrics files of a run, open for appending.
#[derive(Debug)]
pub struct Metrics {
    lines: JsonLines,
    views: Views,
    curves: Arc<Mutex<Curves>>,
}

impl Metrics {
    /// Opens the metrics of a run that resumes after `iteration` and drops later lines. Also returns the iterations
    /// whose evaluations they contain.
    ///
    /// # Errors
    /// A file cannot be read or written.
    pub fn open(
        run_folder: &Path,
        config: &MetricsConfig,
        iteration: u64,
    ) -> Result<(Self, BTreeSet<u64>), FileError> {
        let (mut lines, mut kept) = JsonLines::cut(&run_folder.join(METRICS_FILE), iteration)?;
        restore::restore(run_folder, &mut lines, &mut kept, iteration)?;
        let measured = iterations(&kept, "evaluation");
        let views = Views::make(run_folder, config, &kept)?;
        let mut curves = Curves::default();
        kept.iter().filter_map(Value::as_object).for_each(|line| curves.add(line));
        Ok((Self { lines, views, curves: Arc::new(Mutex::new(curves)) }, measured))
    }

    /// The curves of all figures, those before a resume included. They are updated while the run continues.
    #[must_use]
    pub fn curves(&self) -> Arc<Mutex<Curves>> {
        Arc::clone(&self.curves)
    }

    /// Adds an iteration.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn iteration(&mut self, report: &IterationReport) -> Result<(), FileError> {
        let mut line = Map::new();
        for (name, value) in &report.metrics {
            // JSON cannot represent non-finite numbers; they become null.
            line.insert(name.clone(), json!(value));
        }
        let own = json!({
            "kind": "iteration",
            "iteration": report.iteration,
            "env_steps": report.env_steps,
            "episode_return": report.episode_return,
            "env_steps_per_sec": report.env_steps_per_sec(),
            "iteration_secs": report.iteration_secs,
            "rollout_secs": report.rollout_secs,
            "update_secs": report.update_secs,
            "density_secs": report.density_secs,
            "actors": report.actors,
            "messages_refused": report.messages_refused,
            "leases_reissued": report.leases_reissued,
        });
        line.extend(own.as_object().cloned().unwrap_or_default());
        self.append(line)
    }

    /// Adds an evaluation of the policies after `iteration` iterations.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn evaluation(
        &mut self,
        iteration: u64,
        env_steps: u64,
        spread: &Spread,
        episodes: usize,
    ) -> Result<(), FileError> {
        let line = json!({
            "kind": "evaluation",
            "iteration": iteration,
            "env_steps": env_steps,
            "mean": spread.mean,
            "standard_deviation": spread.standard_deviation,
            "minimum": spread.minimum,
            "maximum": spread.maximum,
            "episodes": episodes,
        });
        self.append(line.as_object().cloned().unwrap_or_default())
    }

    fn append(&mut self, line: Map<String, Value>) -> Result<(), FileError> {
        self.views.add(&line);
        self.curves.lock().unwrap_or_else(PoisonError::into_inner).add(&line);
        self.lines.append(&Value::Object(line))
    }

    /// Flushes all lines to disk.
    ///
    /// # Errors
    /// The file cannot be flushed.
    pub fn sync(&mut self) -> Result<(), FileError> {
        self.lines.sync()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: MetricsConfig = MetricsConfig { csv: true, tensorboard: true };

    fn report(iteration: u64) -> IterationReport {
        IterationReport {
            iteration,
            env_steps: iteration * 40,
            iteration_secs: 0.8,
            rollout_secs: 0.5,
            update_secs: 0.25,
            density_secs: 0.125,
            episode_return: None,
            actors: 2,
            messages_refused: 3,
            leases_reissued: 1,
            metrics: vec![("losses/value".into(), 1.5), ("agent0/sigma".into(), f64::NAN)],
        }
    }

    #[test]
    fn a_line_contains_every_figure_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let (mut metrics, _) = Metrics::open(folder.path(), &ALL, 0).unwrap();
        metrics.iteration(&report(1)).unwrap();
        let text = std::fs::read_to_string(folder.path().join(METRICS_FILE)).unwrap();
        let expected = json!({
            "kind": "iteration", "iteration": 1, "env_steps": 40, "episode_return": null,
            "env_steps_per_sec": 50.0, "iteration_secs": 0.8,
            "rollout_secs": 0.5, "update_secs": 0.25, "density_secs": 0.125, "actors": 2,
            "messages_refused": 3, "leases_reissued": 1,
            "losses/value": 1.5, "agent0/sigma": null,
        });
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), expected);
    }

    #[test]
    fn a_resumed_run_knows_which_evaluations_are_finished() {
        let folder = tempfile::tempdir().unwrap();
        let (mut metrics, measured) = Metrics::open(folder.path(), &ALL, 0).unwrap();
        assert!(measured.is_empty());
        let spread = Spread { mean: 1.0, standard_deviation: 0.0, minimum: 1.0, maximum: 1.0 };
        for iteration in [0, 2, 4] {
            metrics.evaluation(iteration, iteration * 40, &spread, 10).unwrap();
            metrics.iteration(&report(iteration + 1)).unwrap();
        }
        let (_, measured) = Metrics::open(folder.path(), &ALL, 3).unwrap();
        assert_eq!(measured, BTreeSet::from([0, 2]));
    }

    #[test]
    fn a_resume_truncates_the_tables_like_the_lines() {
        let folder = tempfile::tempdir().unwrap();
        let (mut metrics, _) = Metrics::open(folder.path(), &ALL, 0).unwrap();
        (1..=4).for_each(|iteration| metrics.iteration(&report(iteration)).unwrap());
        let table = || std::fs::read_to_string(folder.path().join("metrics.csv")).unwrap();
        let whole = table();
        let (mut metrics, _) = Metrics::open(folder.path(), &ALL, 2).unwrap();
        assert_eq!(table().lines().count(), 3);
        (3..=4).for_each(|iteration| metrics.iteration(&report(iteration)).unwrap());
        assert_eq!(table(), whole);
    }

    #[test]
    fn disabled_files_are_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let none = MetricsConfig { csv: false, tensorboard: false };
        let (mut metrics, _) = Metrics::open(folder.path(), &none, 0).unwrap();
        metrics.iteration(&report(1)).unwrap();
        let names =
            std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name());
        assert_eq!(names.collect::<Vec<_>>(), [METRICS_FILE]);
    }
}
