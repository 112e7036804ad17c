//! The record of an experiment: the evaluations of its finished runs in one CSV file, independent of the run folders.
//! A run in the record is not run again.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::Path;
use std::str::FromStr;

use anyhow::{Context as _, bail};
use learner::store::run_folder::{PROVENANCE, RunFolder};
use policy::arrays::hex;
use serde_json::Value;
use sha2::{Digest as _, Sha256};

use super::run_state::last_lines;
use super::{EVERY_STEPS, PlannedRun};
use crate::config::keys::{EVALUATED, SAMPLED};
use crate::figures::learning_curve::{Curve, Quantity};

const HEADER: &str =
    "task,variant,seed,env_steps,return,surprise,information,settings_sha256,weights_sha256,commit";

/// Task, name of the variant and seed.
type RunName = (String, String, u64);

/// Finished runs by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Record(BTreeMap<RunName, RecordedRun>);

/// One finished run.
#[derive(Clone, Debug, Default, PartialEq)]
struct RecordedRun {
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
        let text = match std::fs::read_to_string(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self::default()),
            text => text.with_context(|| format!("cannot read {}", path.display()))?,
        };
        let mut lines = text.lines().zip(1..);
        if lines.next().is_none_or(|(first, _)| first != HEADER) {
            bail!("{} must begin with the line {HEADER}", path.display());
        }
        let mut record = Self::default();
        for (line, number) in lines {
            let taken = record.take(line);
            taken.with_context(|| format!("{}, line {number}, `{line}`", path.display()))?;
        }
        Ok(record)
    }

    /// Adds one line.
    fn take(&mut self, line: &str) -> anyhow::Result<()> {
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

    /// Whether the record contains the planned run with the same settings and length.
    pub(crate) fn holds(&self, run: &PlannedRun) -> bool {
        self.0.get(&name(run)).is_some_and(|known| {
            let last = known.evaluations.last().map(|last| last.env_steps);
            last == Some(run.config.env_steps())
                && settings_sha256(run) == known.origin.settings_sha256
        })
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
    /// Names the file of the folder that cannot be read.
    pub(crate) fn add(&mut self, run: &PlannedRun, curve: &Curve) -> anyhow::Result<()> {
        let evaluations = evaluations(curve);
        let manifest = RunFolder::recorded(&run.folder)
            .with_context(|| format!("{} has no whole manifest", run.folder.display()))?;
        let last = last_lines(&run.folder.join(PROVENANCE)).pop().unwrap_or_default();
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let origin = Origin {
            settings_sha256: settings_sha256(run),
            weights_sha256: text(&last["weights_sha256"]),
            commit: text(&manifest["git_commit"]),
        };
        self.0.insert(name(run), RecordedRun { evaluations, origin });
        Ok(())
    }

    /// Replaces the file atomically; runs are ordered by task, variant and seed.
    ///
    /// # Errors
    /// Names the file if it cannot be written.
    pub(crate) fn write(&self, path: &Path) -> anyhow::Result<()> {
        if let Some(folder) = path.parent() {
            learner::store::durable::make_folder(folder)?;
        }
        Ok(learner::store::durable::replace(path, self.text().as_bytes())?)
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

/// SHA-256 of the settings that decide what the run computes and how it is evaluated. Only an evaluation that samples actions adds
/// that setting.
fn settings_sha256(run: &PlannedRun) -> String {
    let settings = &run.config.resolved;
    let mut hasher = Sha256::new_with_prefix(settings.sha256());
    for key in [EVERY_STEPS].into_iter().chain(EVALUATED) {
        if key != SAMPLED || run.config.learner.evaluation.sampled {
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
mod tests {
    use super::*;
    use crate::experiment::file::ExperimentFile;
    use crate::experiment::file::tests::SAMPLE;
    use crate::experiment::plan;

    fn planned() -> Vec<PlannedRun> {
        plan(&toml::from_str::<ExperimentFile>(SAMPLE).unwrap()).unwrap()
    }

    /// The curve and the folder of a finished run.
    fn finish(run: &mut PlannedRun, folder: &Path) -> Curve {
        run.folder = folder.to_path_buf();
        let run_folder = RunFolder::claim_new(folder).unwrap();
        run_folder.begin("", &serde_json::json!({"git_commit": "abc"})).unwrap();
        let lines = "{\"weights_sha256\": \"12\"}\n{\"weights_sha256\": \"34\"}\n";
        std::fs::write(folder.join(PROVENANCE), lines).unwrap();
        let returns = vec![(0.0, -1.5), (4000.0, 2.0), (8000.0, 3.25)];
        let surprise = vec![(1000.0, 4.0), (3000.0, 6.0), (7000.0, 8.0)];
        let points = [(Quantity::Return, returns), (Quantity::Surprise, surprise)];
        let (task, algorithm) = (run.task.clone(), run.variant.clone());
        let (seed, settings) = (run.seed.to_string(), BTreeMap::new());
        Curve { task, algorithm, seed, settings, points: points.into() }
    }

    #[test]
    fn a_finished_run_stands_in_the_record_with_its_hash_and_comes_back_as_a_curve() {
        let folder = tempfile::tempdir().unwrap();
        let (path, mut runs) = (folder.path().join("record.csv"), planned());
        let curve = finish(&mut runs[0], folder.path());
        let mut record = Record::read(&path).unwrap();
        assert!(!record.holds(&runs[0]));
        record.add(&runs[0], &curve).unwrap();
        record.write(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[2], "halfcheetah-2x3,happo,0,4000,2,5,,,,");
        let config = settings_sha256(&runs[0]);
        assert_eq!(lines[3], format!("halfcheetah-2x3,happo,0,8000,3.25,8,,{config},34,abc"));
        let again = Record::read(&path).unwrap();
        assert_eq!(again, record);
        assert!(again.holds(&runs[0]) && !again.holds(&runs[1]));
        let found = again.curve(&runs[0]).unwrap();
        assert_eq!(found.of(Quantity::Return), curve.of(Quantity::Return));
        assert_eq!(found.of(Quantity::Surprise), [(4000.0, 5.0), (8000.0, 8.0)]);
    }

    #[test]
    fn a_run_with_another_length_settings_or_evaluations_is_not_the_recorded_one() {
        let folder = tempfile::tempdir().unwrap();
        let mut runs = planned();
        let mut curve = finish(&mut runs[0], folder.path());
        let mut record = Record::default();
        record.add(&runs[0], &curve).unwrap();
        assert!(record.holds(&runs[0]));
        for other in [
            "settings.update.clip = 0.3",
            "settings.evaluation.episodes = 3",
            "settings.evaluation.sampled = true",
        ] {
            let text =
                SAMPLE.replace("settings.evaluation", &format!("{other}\nsettings.evaluation"));
            let file: ExperimentFile = toml::from_str(&text).unwrap();
            assert!(!record.holds(&plan(&file).unwrap()[0]), "{other}");
        }
        curve.points.get_mut(&Quantity::Return).unwrap().pop();
        let mut record = Record::default();
        record.add(&runs[0], &curve).unwrap();
        assert!(!record.holds(&runs[0]) && record.curve(&runs[0]).is_none(), "a shorter one");
    }

    #[test]
    fn a_line_that_is_no_evaluation_is_refused_with_its_number() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("record.csv");
        let good = "ant-4x2,happo,0,4000,2,5,,,,";
        for (text, words) in [
            ("x\n".to_owned(), "must begin with the line task,variant"),
            (format!("{HEADER}\n{good}\nant-4x2,happo\n"), "line 3"),
            (format!("{HEADER}\n{good}\n{good}\n"), "env_steps must grow"),
            (format!("{HEADER}\nant-4x2,happo,0,4000,NaN,5,,,,\n"), "`NaN` is not finite"),
            (format!("{HEADER}\nant-4x2,happo,x,4000,2,5,,,,\n"), "`x` is no number"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = format!("{:#}", Record::read(&path).unwrap_err());
            assert!(error.contains(words) && error.contains("record.csv"), "{error}");
        }
    }
}
