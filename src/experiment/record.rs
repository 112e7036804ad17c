//! The record of an experiment: the evaluations of its finished runs in one CSV file, independent of the run folders.
//! A run in the record is not run again.

mod agreement;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;
use std::str::FromStr;

use anyhow::{Context as _, bail};
use learner::store::run_folder::{METRICS, PROVENANCE, RunFolder, STARTS};
use learner::store::{durable, plain_file};
use policy::arrays::hex;
use sha2::{Digest as _, Sha256};

use super::run_state::{last_lines, mismatch};
use super::{EVALUATIONS, EVERY_STEPS, PlannedRun};
use crate::config::keys::{EVALUATED, SAMPLED};
use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::figures::chart::{count_of, thousands};
use crate::figures::learning_curve::{Curve, Quantity};
use crate::process::target::Target;
use crate::run::recorded::all_lines;
use crate::run::stored::config_of_run;

const HEADER: &str =
    "task,variant,seed,env_steps,return,surprise,information,settings_sha256,weights_sha256,commit";

/// A record larger than this is a mistake.
const LIMIT_BYTES: u64 = 256 << 20;

/// Task, name of the variant and seed.
type RunName = (String, String, u64);

/// Finished runs by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Record(BTreeMap<RunName, FinishedRun>);

/// One finished run.
#[derive(Clone, Debug, Default, PartialEq)]
struct FinishedRun {
    /// In order of environment steps; at least one.
    evaluations: Vec<Evaluation>,
    /// Fields that only the last line of the run contains.
    origin: Origin,
}

/// Settings, program and final weights of a run.
#[derive(Clone, Debug, Default, PartialEq)]
struct Origin {
    /// SHA-256 of the settings that affect the result and the evaluations.
    settings_sha256: String,
    /// SHA-256 of the final weights.
    weights_sha256: String,
    /// Commit of the program that started the run.
    commit: String,
}

/// One evaluation, with means over the iterations since the previous one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Evaluation {
    env_steps: u64,
    mean_return: f64,
    surprise: Option<f64>,
    information: Option<f64>,
}

impl Record {
    /// Reads the file. The record is empty if there is no file, or no path.
    ///
    /// # Errors
    /// Names the file and the invalid line.
    pub(crate) fn read(path: &Path) -> anyhow::Result<Self> {
        let text = match plain_file::named_text(path, LIMIT_BYTES) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self::default()),
            text => text.with_context(|| format!("cannot read {}", path.display()))?,
        };
        // Spreadsheets begin a file with a byte order mark.
        let mut lines = text.trim_start_matches('\u{feff}').lines().zip(1..);
        if lines.next().is_none_or(|(first, _)| first != HEADER) {
            bail!("{} must begin with the line {HEADER}", path.display());
        }
        let mut record = Self::default();
        for (line, number) in lines.filter(|(line, _)| !line.is_empty()) {
            let taken = record.add_line(line);
            taken.with_context(|| format!("{}, line {number}, `{line}`", path.display()))?;
        }
        Ok(record)
    }

    /// Adds one line.
    fn add_line(&mut self, line: &str) -> anyhow::Result<()> {
        let fields: Vec<&str> = line.split(',').collect();
        let [
            task,
            variant,
            seed,
            env_steps,
            mean_return,
            surprise,
            information,
            settings,
            weights,
            commit,
        ] = fields[..]
        else {
            bail!("has {} of 10 fields", fields.len());
        };
        let optional = |text: &str| (!text.is_empty()).then(|| finite(text)).transpose();
        let evaluation = Evaluation {
            env_steps: number(env_steps)?,
            mean_return: finite(mean_return)?,
            surprise: optional(surprise)?,
            information: optional(information)?,
        };
        let name = (task.to_owned(), variant.to_owned(), number(seed)?);
        let run = self.0.entry(name).or_default();
        let [settings_sha256, weights_sha256, commit] =
            [settings, weights, commit].map(str::to_owned);
        run.origin = Origin { settings_sha256, weights_sha256, commit };
        if run.evaluations.last().is_some_and(|last| last.env_steps >= evaluation.env_steps) {
            bail!("env_steps must grow");
        }
        run.evaluations.push(evaluation);
        Ok(())
    }

    /// Whether the record contains the planned run with the same settings and all its evaluations.
    pub(crate) fn holds(&self, run: &PlannedRun) -> bool {
        self.0.get(&name(run)).is_some_and(|known| {
            missing_evaluation(&known.evaluations, &run.config).is_none()
                && settings_sha256(&run.config) == known.origin.settings_sha256
        })
    }

    /// Why the planned run must not replace the recorded one of the same name; `None` if there is none, or a shorter one with the
    /// same settings.
    pub(crate) fn conflict(&self, run: &PlannedRun) -> Option<String> {
        let known = self.0.get(&name(run)).filter(|_| !self.holds(run))?;
        let (recorded, planned) = (known.env_steps(), run.config.env_steps());
        let damaged = |what: &str| {
            Some(format!(
                "the record of {} has no {what}; delete its lines, and the run is recorded again from its folder, or repeated",
                run.name()
            ))
        };
        let is_same = settings_sha256(&run.config) == known.origin.settings_sha256;
        let has = if known.origin.settings_sha256.is_empty() {
            return damaged("last line, which has the hashes of a run");
        } else if !is_continued(known, run, recorded) || (recorded == planned && !is_same) {
            "with other settings".to_owned()
        } else if recorded > planned {
            format!("with {} steps, more than are planned", thousands(recorded))
        } else if recorded == planned {
            return damaged(&missing_evaluation(&known.evaluations, &run.config)?);
        } else {
            return None;
        };
        Some(format!("the record has {} {has}; set another `record` and `folder`", run.name()))
    }

    /// Refuses runs that must not replace recorded ones, before they are computed.
    pub(crate) fn demand_new(&self, path: &Path, runs: &[PlannedRun]) -> Result<(), Usage> {
        let mut conflicts = runs.iter().filter_map(|run| self.conflict(run));
        let Some(first) = conflicts.next() else { return Ok(()) };
        let others = match conflicts.count() {
            0 => String::new(),
            others => format!(" ({}, too)", count_of(others as u64, "other run")),
        };
        Err(Usage::new(format!("{}: {first}{others}", path.display())))
    }

    /// The curve of the planned run, if the record contains it.
    pub(crate) fn curve(&self, run: &PlannedRun) -> Option<Curve> {
        let known = self.0.get(&name(run)).filter(|_| self.holds(run))?;
        let task = run.task.clone();
        let algorithm = run.variant.clone();
        let seed = run.seed.to_string();
        let points = points(&known.evaluations);
        Some(Curve { task, algorithm, seed, settings: BTreeMap::new(), points })
    }

    /// Adds a finished run from its folder, with its curve.
    ///
    /// # Errors
    /// Names the file of the folder that cannot be read or is not whole.
    pub(crate) fn add(&mut self, run: &PlannedRun, curve: &Curve) -> anyhow::Result<()> {
        let evaluations = evaluations(curve);
        // A manifest that was written again has another commit.
        let starts = all_lines(&run.folder.join(STARTS))?;
        let commit = starts.first().and_then(|start| start["git_commit"].as_str());
        let provenance = run.folder.join(PROVENANCE);
        let last = last_lines(&provenance).pop().unwrap_or_default();
        let weights_sha256 = last["weights_sha256"].as_str();
        let weights_sha256 = weights_sha256
            .filter(|_| last["iteration"] == run.config.iterations())
            .with_context(|| format!("{} lacks its last line", provenance.display()))?;
        let origin = Origin {
            settings_sha256: settings_sha256(&run.config),
            weights_sha256: weights_sha256.to_owned(),
            commit: commit.unwrap_or_default().to_owned(),
        };
        self.0.insert(name(run), FinishedRun { evaluations, origin });
        Ok(())
    }

    /// Adds its runs to the file, which is replaced atomically; runs are ordered by task, variant and seed. Other
    /// experiments with this record wait meanwhile, so that none loses the runs of another.
    ///
    /// # Errors
    /// Names the file if it cannot be read or written.
    pub(crate) fn add_to(self, path: &Path) -> anyhow::Result<()> {
        if self.0.is_empty() {
            return Ok(());
        }
        let target = place(path)?;
        let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let folder = File::open(folder.unwrap_or(Path::new(".")))?;
        // Where a file system has no locks, the experiments are on their own.
        let _locked = folder.lock();
        let mut all = Self::read(path)?;
        for (name, run) in self.0 {
            // A run with other settings that another experiment has added meanwhile stays, and is a conflict of the next report.
            let known = all.0.get(&name).filter(|other| other.env_steps() >= run.env_steps());
            if known.is_none_or(|other| other.origin.settings_sha256 == run.origin.settings_sha256)
            {
                all.0.insert(name, run);
            }
        }
        target.write(all.text().as_bytes())
    }

    fn text(&self) -> String {
        let mut text = format!("{HEADER}\n");
        let optional = |value: Option<f64>| value.map_or_else(String::new, |x| x.to_string());
        for ((task, variant, seed), run) in &self.0 {
            let last = run.evaluations.len().saturating_sub(1);
            for (index, e) in run.evaluations.iter().enumerate() {
                let (surprise, information) = (optional(e.surprise), optional(e.information));
                let Origin { settings_sha256, weights_sha256, commit } = &run.origin;
                let origin = if index == last {
                    format!("{settings_sha256},{weights_sha256},{commit}")
                } else {
                    ",,".to_owned()
                };
                let (env_steps, mean_return) = (e.env_steps, e.mean_return);
                text += &format!(
                    "{task},{variant},{seed},{env_steps},{mean_return},{surprise},{information},{origin}\n"
                );
            }
        }
        text
    }
}

impl FinishedRun {
    fn env_steps(&self) -> u64 {
        self.evaluations.last().map_or(0, |last| last.env_steps)
    }
}

/// The place of a record, in a folder that is made if necessary. A link is followed.
///
/// # Errors
/// The folder cannot be made, or something other than a plain file is there.
pub(crate) fn place(path: &Path) -> anyhow::Result<Target> {
    path.parent().map_or(Ok(()), durable::make_folder)?;
    Target::fixed(&path.canonicalize().unwrap_or_else(|_| path.to_owned()))
}

/// Refuses the curve of a finished run that lacks an evaluation.
///
/// # Errors
/// Names the run's metrics and the evaluation.
pub(crate) fn demand_whole(run: &PlannedRun, curve: &Curve) -> anyhow::Result<()> {
    match missing_evaluation(&evaluations(curve), &run.config) {
        None => Ok(()),
        Some(what) => bail!("{} has no {what}", run.folder.join(METRICS).display()),
    }
}

/// The first evaluation that a run of these settings should have and that is not among these; `None` if all are. One is at the
/// start, one at the end, and one after the iteration that passes the end of an interval. A run that became longer may have other
/// ones before, if none follows another later than those of the new interval.
fn missing_evaluation(evaluations: &[Evaluation], config: &RunConfig) -> Option<String> {
    let (schedule, end) = (&config.learner.evaluation, config.env_steps());
    let iteration = config.learner.environments.steps_per_iteration();
    let is_due = |number: &u64| schedule.is_due(*number, iteration, config.iterations());
    let is_planned = |steps: &u64| steps.is_multiple_of(iteration) && is_due(&(steps / iteration));
    let found: BTreeSet<u64> = evaluations.iter().map(|evaluation| evaluation.env_steps).collect();
    let is_at_end = found.last() == Some(&end);
    if !is_at_end || found.iter().all(is_planned) {
        let mut planned = (0..=config.iterations()).filter(is_due).map(|number| number * iteration);
        let lost = planned.find(|steps| !found.contains(steps));
        let lost = lost.or((!is_at_end).then_some(end));
        return lost.map(|steps| format!("evaluation at {} steps", thousands(steps)));
    }
    let most = schedule.every_steps + iteration;
    let ends = found.iter().skip(1);
    let gap = found.iter().zip(ends).find(|(before, after)| *after - *before >= most);
    let before = if found.contains(&0) { gap.map(|(before, _)| *before) } else { Some(0) };
    before.map(|before| format!("evaluation soon after {} steps", thousands(before)))
}

/// All quantities of the curve at its evaluations.
pub(crate) fn at_evaluations(curve: Curve) -> Curve {
    let points = points(&evaluations(&curve));
    Curve { points, ..curve }
}

fn evaluations(curve: &Curve) -> Vec<Evaluation> {
    let mut before = f64::NEG_INFINITY;
    let evaluation = |&(env_steps, mean_return): &(f64, f64)| {
        let since = (before, env_steps);
        before = env_steps;
        Evaluation {
            env_steps: env_steps as u64,
            mean_return,
            surprise: mean_within(curve.of(Quantity::Surprise), since),
            information: mean_within(curve.of(Quantity::Information), since),
        }
    };
    curve.of(Quantity::Return).iter().map(evaluation).collect()
}

fn points(evaluations: &[Evaluation]) -> BTreeMap<Quantity, Vec<(f64, f64)>> {
    let points = |of: fn(&Evaluation) -> Option<f64>| -> Vec<(f64, f64)> {
        let point = |e: &Evaluation| Some((e.env_steps as f64, of(e)?));
        evaluations.iter().filter_map(point).collect()
    };
    BTreeMap::from([
        (Quantity::Return, points(|e| Some(e.mean_return))),
        (Quantity::Surprise, points(|e| e.surprise)),
        (Quantity::Information, points(|e| e.information)),
    ])
}

fn name(run: &PlannedRun) -> RunName {
    (run.task.clone(), run.variant.clone(), run.seed)
}

/// Whether the planned run has the settings of the recorded one of `env_steps` steps. The default interval between evaluations
/// depends on the length; a longer run in the same folder may also have a longer interval.
fn is_continued(recorded: &FinishedRun, run: &PlannedRun, env_steps: u64) -> bool {
    let recorded = &recorded.origin.settings_sha256;
    let every = run.config.learner.evaluation.every_steps;
    let intervals = [every, (env_steps / EVALUATIONS).max(1)];
    let own = intervals.map(|every| sha256_with(&run.config, &every.to_string()));
    let in_folder = || {
        let known = RunFolder::holds_run(&run.folder) && mismatch(run).is_none();
        known.then(|| config_of_run(&run.folder).ok()).flatten()
    };
    own.contains(recorded) || in_folder().is_some_and(|old| settings_sha256(&old) == *recorded)
}

/// SHA-256 of the settings that decide what the run computes and how it is evaluated.
fn settings_sha256(config: &RunConfig) -> String {
    sha256_with(config, &config.resolved.shown(EVERY_STEPS))
}

/// As [`settings_sha256`], with this interval between evaluations. Only an evaluation that samples actions adds that setting.
fn sha256_with(config: &RunConfig, every_steps: &str) -> String {
    let settings = &config.resolved;
    let mut hasher = Sha256::new_with_prefix(settings.sha256());
    // The URL is not among those settings, but an external environment is not the simulator's of the same name.
    if !config.environment.url.is_empty() {
        hasher.update("external environment\n");
    }
    hasher.update(format!("{EVERY_STEPS} = {every_steps}\n"));
    for key in EVALUATED {
        if key != SAMPLED || config.learner.evaluation.sampled {
            hasher.update(format!("{key} = {}\n", settings.shown(key)));
        }
    }
    hex(&hasher.finalize())
}

fn finite(text: &str) -> anyhow::Result<f64> {
    let value: f64 = number(text)?;
    anyhow::ensure!(value.is_finite(), "`{text}` is not finite");
    Ok(value)
}

fn number<T: FromStr>(text: &str) -> anyhow::Result<T> {
    text.parse().map_err(|_| anyhow::anyhow!("`{text}` is no number that fits there"))
}

/// Mean of the points after the first number of environment steps, up to the second.
fn mean_within(points: &[(f64, f64)], (after, up_to): (f64, f64)) -> Option<f64> {
    let within = points.iter().filter(|(env_steps, _)| *env_steps > after && *env_steps <= up_to);
    let values: Vec<f64> = within.map(|(_, value)| *value).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests;
