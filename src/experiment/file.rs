//! The file that describes an experiment: its own keys only. `config` checks the settings of the runs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use learner::store::plain_file;
use serde::Deserialize;
use toml::{Table, Value};

use crate::config::line_and_message;
use crate::config::own_task::OwnTask;
use crate::errors::Usage;
use crate::process::shell;
use crate::run::pretrained::team_record;

/// Settings that keys of the experiment file replace.
const DECIDED: [&str; 8] = [
    "task",
    "algorithm",
    "run.seed",
    "run.env_steps",
    "run.iterations",
    "run.dir",
    "run.actors",
    "learner.threads",
];

/// An experiment file larger than this is a mistake.
pub(super) const LIMIT_BYTES: u64 = 1 << 20;

/// The folder of the program's own experiments, in the folder to which their paths are relative.
const SHIPPED: &str = "configs/experiments";
/// Algorithm of the default baseline.
const BASELINE: &str = "happo";

/// The whole file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExperimentFile {
    /// Path of the file.
    #[serde(skip)]
    pub(crate) path: PathBuf,
    /// Folder of run folders, tables and figures; the file may leave it out: `runs/` and the file's name.
    #[serde(default)]
    pub(crate) folder: PathBuf,
    /// CSV file of the finished runs, which are not run again; empty: no file.
    #[serde(default)]
    pub(crate) record: PathBuf,
    /// `folder` and `record` as the file has them.
    #[serde(skip)]
    pub(crate) written: [PathBuf; 2],
    /// Environment steps of each run.
    pub(crate) env_steps: u64,
    /// Seeds of each variant on each task.
    pub(crate) seeds: Vec<u64>,
    /// Tasks.
    pub(crate) tasks: Vec<String>,
    /// Actor processes of each run.
    #[serde(default = "one")]
    pub(crate) actors: usize,
    /// Learner threads of each run.
    #[serde(default = "one")]
    pub(crate) threads: usize,
    /// The variant with which the others are compared; empty: the first that runs HAPPO, or the first.
    #[serde(default)]
    pub(crate) baseline: String,
    /// Share of the best variant's final return that counts as learnt.
    #[serde(default = "four_fifths")]
    pub(crate) threshold: f64,
    /// URL of the external program that offers the environment of a task; other tasks use the simulator.
    #[serde(default)]
    pub(crate) environments: BTreeMap<String, String>,
    /// Settings of all runs.
    pub(crate) settings: Option<Table>,
    /// The variants that are compared.
    pub(crate) variants: Vec<Variant>,
}

/// A variant: an algorithm with settings.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Variant {
    /// Name in tables, figures and run folders; empty: the algorithm's name.
    #[serde(default)]
    pub(crate) name: String,
    /// Algorithm.
    pub(crate) algorithm: String,
    /// Its tasks, if it does not run on all.
    pub(crate) tasks: Option<Vec<String>>,
    /// Its seeds, if they differ from the experiment's.
    pub(crate) seeds: Option<Vec<u64>>,
    /// Its environment steps, if they differ from the experiment's.
    pub(crate) env_steps: Option<u64>,
    /// Its settings, which override those of all runs.
    pub(crate) settings: Option<Table>,
}

impl ExperimentFile {
    /// Reads and checks the file.
    pub(crate) fn read(path: &Path) -> Result<Self, Usage> {
        let refused = |detail: String| Usage::new(format!("{}: {detail}", path.display()));
        let text = plain_file::named_text(path, LIMIT_BYTES);
        let text = text.map_err(|error| refused(error.to_string()))?;
        Self::parse(path, &text).map_err(refused)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, String> {
        let written: Self = toml::from_str(text).map_err(|error| {
            let (line, detail) = line_and_message(text, &error);
            format!("line {line}: {detail}")
        })?;
        let file = Self { path: path.to_path_buf(), ..written }.completed()?;
        file.validate()?;
        Ok(file)
    }

    /// Fills in the names and the folder that the file omits, and finds its paths.
    fn completed(mut self) -> Result<Self, String> {
        self.written = [self.folder.clone(), self.record.clone()];
        for variant in self.variants.iter_mut().filter(|variant| variant.name.is_empty()) {
            variant.name.clone_from(&variant.algorithm);
        }
        if self.folder.as_os_str().is_empty() {
            self.folder = Path::new("runs").join(self.path.file_stem().unwrap_or_default());
        }
        self.find_paths()?;
        if self.baseline.is_empty() {
            let usual = self.variants.iter().find(|variant| variant.algorithm == BASELINE);
            let baseline = usual.or(self.variants.first()).map(|variant| variant.name.clone());
            self.baseline = baseline.unwrap_or_default();
        }
        Ok(self)
    }

    /// Makes the file's paths relative to its base instead of the folder in which the command is typed.
    fn find_paths(&mut self) -> Result<(), String> {
        let base = base(&self.path);
        let found = |path: &Path| {
            shell::expanded(path).map(|path| base.join(path)).map_err(|why| why.to_string())
        };
        self.folder = found(&self.folder)?;
        if !self.record.as_os_str().is_empty() {
            self.record = found(&self.record)?;
        }
        let found_task = |task: &str| {
            if OwnTask::is_path(task) {
                found(Path::new(task)).map(|path| path.to_string_lossy().into_owned())
            } else {
                Ok(task.to_owned())
            }
        };
        let of_variants = self.variants.iter_mut().filter_map(|variant| variant.tasks.as_mut());
        for task in of_variants.chain([&mut self.tasks]).flatten() {
            *task = found_task(task)?;
        }
        let environments = std::mem::take(&mut self.environments).into_iter();
        self.environments = environments
            .map(|(task, url)| Ok((found_task(&task)?, url)))
            .collect::<Result<_, String>>()?;
        let of_variants = self.variants.iter_mut().filter_map(|variant| variant.settings.as_mut());
        for settings in of_variants.chain(self.settings.as_mut()) {
            let policy = settings.get_mut("policy").and_then(Value::as_table_mut);
            if let Some(Value::String(start)) = policy.and_then(|section| section.get_mut("start"))
                && team_record(start).is_none()
            {
                *start = found(Path::new(start))?.to_string_lossy().into_owned();
            }
        }
        Ok(())
    }

    fn validate(&self) -> Result<(), String> {
        distinct("seeds", &self.seeds)?;
        distinct("tasks", &self.tasks)?;
        if self.variants.is_empty() {
            return Err("variants must not be empty: a [[variants]] has an algorithm".to_owned());
        }
        distinct("names of variants", &self.variants.iter().map(|v| &v.name).collect::<Vec<_>>())?;
        self.variants.iter().try_for_each(Variant::validate)?;
        self.environments.keys().try_for_each(|task| self.demand_task(task))?;
        undecided("settings", self.settings.as_ref())?;
        if !self.variants.iter().any(|variant| variant.name == self.baseline) {
            return Err(format!("baseline = \"{}\" must be the name of a variant", self.baseline));
        }
        if !(self.threshold > 0.0 && self.threshold <= 1.0) {
            return Err(format!("threshold must be above 0 and at most 1, is {}", self.threshold));
        }
        match (self.actors, self.threads) {
            (1..=1024, 1..=1024) => Ok(()),
            (actors, threads) => {
                Err(format!("actors and threads must lie in 1..=1024, are {actors} and {threads}"))
            }
        }
    }

    /// Refuses an environment of a task that no run has.
    fn demand_task(&self, task: &String) -> Result<(), String> {
        let own = self.variants.iter().filter_map(|variant| variant.tasks.as_ref()).flatten();
        if !self.tasks.iter().chain(own).any(|known| known == task) {
            return Err(format!("environments: \"{task}\" is not among the tasks"));
        }
        Ok(())
    }

    /// Number of simultaneous runs on `cores`: the actors and the learner threads of a run work alternately.
    pub(crate) fn runs_at_once(&self, cores: usize) -> usize {
        (cores / self.actors.max(self.threads)).max(1)
    }
}

impl Variant {
    fn validate(&self) -> Result<(), String> {
        let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
        if self.name.is_empty() || !self.name.chars().all(plain) {
            return Err(format!("name = \"{}\" must be letters, digits, - _ or .", self.name));
        }
        self.tasks.as_ref().map_or(Ok(()), |tasks| distinct("tasks", tasks))?;
        self.seeds.as_ref().map_or(Ok(()), |seeds| distinct("seeds", seeds))?;
        undecided(&format!("settings of {}", self.name), self.settings.as_ref())
    }
}

/// The folder to which the paths in an experiment's file are relative: that of the file; for `configs/experiments` the one
/// with `configs`.
fn base(file: &Path) -> PathBuf {
    let whole = std::path::absolute(file).unwrap_or_else(|_| file.to_path_buf());
    let levels = if whole.parent().is_some_and(|it| it.ends_with(SHIPPED)) { 3 } else { 1 };
    let base = whole.ancestors().nth(levels).unwrap_or(&whole);
    let here = std::env::current_dir().unwrap_or_default();
    base.strip_prefix(here).unwrap_or(base).to_path_buf()
}

fn one() -> usize {
    1
}

fn four_fifths() -> f64 {
    0.8
}

/// Refuses a list that is empty or holds something twice.
fn distinct<T: Ord>(key: &str, values: &[T]) -> Result<(), String> {
    let different: BTreeSet<&T> = values.iter().collect();
    if values.is_empty() {
        return Err(format!("{key} must not be empty"));
    }
    if different.len() < values.len() {
        return Err(format!("{key} must differ from each other"));
    }
    Ok(())
}

fn undecided(place: &str, settings: Option<&Table>) -> Result<(), String> {
    let keys = settings.map(assignments).unwrap_or_default();
    let key = keys.iter().filter_map(|assignment| assignment.split('=').next());
    match key.into_iter().find(|key| DECIDED.contains(key)) {
        Some(key) => Err(format!("{place}: `{key}` is decided by the experiment's own keys")),
        None => Ok(()),
    }
}

/// A table of settings as `key.path=value`.
pub(crate) fn assignments(table: &Table) -> Vec<String> {
    let of = |(key, value): (&String, &Value)| match value {
        Value::Table(inner) => {
            assignments(inner).into_iter().map(|inside| format!("{key}.{inside}")).collect()
        }
        Value::String(text) => vec![format!("{key}={text}")],
        other => vec![format!("{key}={other}")],
    };
    table.iter().flat_map(of).collect()
}

#[cfg(test)]
pub(crate) mod tests;
