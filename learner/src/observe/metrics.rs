//! `metrics.jsonl`: one line per iteration and one per evaluation, each exactly once.
//!
//! `iteration` is the number of finished iterations: in the line of an iteration, including that one; in the line of an
//! evaluation, that of the evaluated policies. `tensorboard/` contains the same figures. It is written anew from the lines
//! when a run starts or resumes, so that it also shows each iteration once.

mod curves;
mod event_file;
mod tags;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use serde_json::{Value, json};

pub use self::curves::{Curves, MetricCurve};
use self::event_file::EventFile;
use crate::observe::event::{EvaluationReport, IterationReport};
use crate::store::durable::FileError;
use crate::store::json_lines::JsonLines;
use crate::store::run_folder::{METRICS, TENSORBOARD};

/// The metrics files of a run, open for appending.
#[derive(Debug)]
pub struct Metrics {
    lines: JsonLines,
    /// `None` once a line could not be written.
    events: Option<EventFile>,
    curves: Arc<Mutex<Curves>>,
}

/// Mean returns of a run's evaluations, by the iteration of the evaluated policies.
pub type Returns = BTreeMap<u64, f64>;

/// An evaluation in `metrics.jsonl`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredReturn {
    /// Iteration of the evaluated policies.
    pub iteration: u64,
    /// Environment steps that they have trained for.
    pub env_steps: u64,
    /// Mean return.
    pub mean: f64,
    /// Whether actions were sampled. Others are means, or the likeliest choices.
    pub sampled: bool,
}

impl MeasuredReturn {
    /// The result of a report.
    #[must_use]
    pub fn of(report: &EvaluationReport) -> Self {
        Self {
            iteration: report.iteration,
            env_steps: report.env_steps,
            mean: report.spread.mean,
            sampled: report.sampled,
        }
    }
}

/// The results of the evaluations in the lines of `metrics.jsonl`.
pub fn measured(lines: &[Value]) -> Vec<MeasuredReturn> {
    let evaluations = lines.iter().filter(|line| line["kind"] == "evaluation");
    let measured = |line: &Value| {
        Some(MeasuredReturn {
            iteration: line["iteration"].as_u64()?,
            env_steps: line["env_steps"].as_u64()?,
            mean: line["mean"].as_f64()?,
            sampled: line["sampled"].as_bool().unwrap_or(false),
        })
    };
    evaluations.filter_map(measured).collect()
}

/// The results that can be compared with each other: those with actions of the same kind, mean or sampled, as in the last
/// evaluation.
pub fn comparable(all: &[MeasuredReturn]) -> impl Iterator<Item = &MeasuredReturn> {
    all.iter().filter(|one| all.last().is_some_and(|last| last.sampled == one.sampled))
}

/// The mean returns of the [`comparable`] results.
#[must_use]
pub fn returns(all: &[MeasuredReturn]) -> Returns {
    comparable(all).map(|one| (one.iteration, one.mean)).collect()
}

impl Metrics {
    /// Opens the metrics of a run that resumes after `iteration` and drops later lines. Also returns the results of the
    /// evaluations that they contain.
    ///
    /// # Errors
    /// A file cannot be read or written.
    pub fn open(
        run_folder: &Path,
        iteration: u64,
    ) -> Result<(Self, Vec<MeasuredReturn>), FileError> {
        let (lines, kept) = JsonLines::cut(&run_folder.join(METRICS), iteration)?;
        let measured = measured(&kept);
        let events = EventFile::make(&run_folder.join(TENSORBOARD), &kept, SystemTime::now())?;
        let mut curves = Curves::default();
        kept.iter().for_each(|line| curves.add(line));
        Ok((Self { lines, events: Some(events), curves: Arc::new(Mutex::new(curves)) }, measured))
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
        let mut line = json!(report);
        line["kind"] = "iteration".into();
        line["env_steps_per_sec"] = json!(report.env_steps_per_sec());
        self.append(line, &report.metrics)
    }

    /// Adds an evaluation.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn evaluation(&mut self, report: &EvaluationReport) -> Result<(), FileError> {
        let mut line = json!(report);
        line["kind"] = "evaluation".into();
        self.append(line, &report.metrics)
    }

    /// Appends a line with more figures.
    fn append(&mut self, mut line: Value, figures: &[(String, f64)]) -> Result<(), FileError> {
        for (name, value) in figures {
            // JSON cannot represent non-finite numbers; they become null.
            line[name] = json!(value);
        }
        self.add_event(&line);
        self.curves.lock().unwrap_or_else(PoisonError::into_inner).add(&line);
        self.lines.append(&line)
    }

    /// Adds a line to the event file. One that cannot be written is logged and dropped instead of ending the run,
    /// because a resume writes it anew.
    fn add_event(&mut self, line: &Value) {
        let Some(events) = &mut self.events else { return };
        if let Err(error) = events.add(line) {
            tracing::error!("{error}; the next resume of the run writes it anew");
            self.events = None;
        }
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
    use crate::observe::event::Spread;

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
        let (mut metrics, _) = Metrics::open(folder.path(), 0).unwrap();
        metrics.iteration(&report(1)).unwrap();
        let text = std::fs::read_to_string(folder.path().join(METRICS)).unwrap();
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
        let (mut metrics, measured) = Metrics::open(folder.path(), 0).unwrap();
        assert!(measured.is_empty());
        let spread = Spread { mean: 1.0, standard_deviation: 0.0, minimum: 1.0, maximum: 1.0 };
        for iteration in [0, 2, 4] {
            let env_steps = iteration * 40;
            let (episodes, sampled, figures) = (10, false, Vec::new());
            let evaluation = EvaluationReport {
                iteration,
                env_steps,
                spread,
                episodes,
                sampled,
                metrics: figures,
            };
            metrics.evaluation(&evaluation).unwrap();
            metrics.iteration(&report(iteration + 1)).unwrap();
        }
        let (_, measured) = Metrics::open(folder.path(), 3).unwrap();
        assert_eq!(returns(&measured), Returns::from([(0, 1.0), (2, 1.0)]));
    }

    #[test]
    fn returns_of_sampled_actions_are_not_compared_with_those_of_mean_actions() {
        let of = |iteration, mean, sampled| {
            let env_steps = 100 * iteration;
            MeasuredReturn { iteration, env_steps, mean, sampled }
        };
        let all = [of(0, 9.0, false), of(2, 1.0, true), of(4, 2.0, true)];
        assert_eq!(returns(&all), Returns::from([(2, 1.0), (4, 2.0)]));
        assert_eq!(returns(&[all[1], all[0]]), Returns::from([(0, 9.0)]));
        assert!(returns(&[]).is_empty());
    }
}
