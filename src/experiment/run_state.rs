//! The state of an experiment's runs, read from their folders, and whether the experiment may write into its own.

use std::io::ErrorKind;
use std::path::Path;

use anyhow::Context as _;
use learner::store::run_folder::{METRICS, RunFolder};
use learner::store::{durable, json_lines};
use serde_json::Value;

use super::file::ExperimentFile;
use super::record::Record;
use super::{EVERY_STEPS, PlannedRun, report};
use crate::config::ConfigError;
use crate::config::keys::{EVALUATED, URL};
use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::figures::chart;
use crate::run::resume;
use crate::run::run_path::{Others, demand_outside_runs};
use crate::run::stored::{config_of_run, own_settings};

/// Number of bytes that contains the last lines of a `metrics.jsonl`.
const TAIL_BYTES: u64 = 64 << 10;

/// State of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RunFolderState {
    /// The folder contains no run.
    New,
    /// The run is in progress or can be resumed.
    Begun {
        /// Environment steps of its finished iterations.
        env_steps: u64,
    },
    /// The last evaluation and the checkpoint before it are written, and the folder has its settings and its manifest.
    Finished,
}

impl RunFolderState {
    /// Environment steps done, of a run that has `total`.
    pub(crate) fn env_steps(self, total: u64) -> u64 {
        match self {
            Self::New => 0,
            Self::Begun { env_steps } => env_steps.min(total),
            Self::Finished => total,
        }
    }
}

/// Refuses a record in the place of a file or folder that the experiment writes itself, or in a run.
///
/// # Errors
/// Names what is in its place.
pub(crate) fn demand_own_record(file: &ExperimentFile, runs: &[PlannedRun]) -> Result<(), Usage> {
    let record = &file.record;
    let refused = |what: &str| {
        let (path, written) = (file.path.display(), file.written[1].display());
        Err(Usage::new(format!("{path}: record = \"{written}\" is {what}; name another file")))
    };
    let name = record.file_name().unwrap_or_default().to_string_lossy();
    if record.as_os_str().is_empty() {
        return Ok(());
    }
    let is_around = file.folder.starts_with(record);
    if is_around || record.is_dir() || record.as_os_str().as_encoded_bytes().ends_with(b"/") {
        return refused("a folder");
    }
    if runs.iter().any(|run| record.starts_with(&run.folder) || *record == run.log()) {
        return refused("in the place of a run or its log");
    }
    let is_own = report::is_part(&name) || name.starts_with("slurm");
    if record.parent() == Some(&file.folder) && is_own {
        return refused("in the place of the experiment's own table, figure or script");
    }
    demand_outside_runs(record)
}

/// How one run ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The run has finished.
    Finished,
    /// The run was stopped and can be resumed.
    Stopped,
    /// The run failed, with the reason.
    Failed(String),
    /// The folder holds a run with other settings, with the difference.
    Misplaced(String),
}

/// The state of the run; does not check whether the folder holds this run.
pub(crate) fn run_state(run: &PlannedRun) -> RunFolderState {
    if !RunFolder::holds_run(&run.folder) {
        return RunFolderState::New;
    }
    let last = last_lines(&run.folder.join(METRICS));
    let finished =
        |line: &Value| line["kind"] == "evaluation" && line["iteration"] == run.config.iterations();
    // A resume writes the settings and the manifest again.
    let is_whole =
        || RunFolder::recorded(&run.folder).is_some() && own_settings(&run.folder).is_ok();
    if last.iter().any(finished) && is_whole() {
        return RunFolderState::Finished;
    }
    let steps = last.iter().filter_map(|line| line["env_steps"].as_u64());
    RunFolderState::Begun { env_steps: steps.max().unwrap_or(0) }
}

/// Whether the folder holds this run and it is finished.
pub(crate) fn is_finished(run: &PlannedRun) -> bool {
    run_state(run) == RunFolderState::Finished && mismatch(run).is_none()
}

/// How the run in the folder differs from the planned one; `None` if it does not, or if there is none.
pub(crate) fn mismatch(run: &PlannedRun) -> Option<String> {
    if !RunFolder::holds_run(&run.folder) {
        return None;
    }
    let same = config_of_run(&run.folder).and_then(|old| {
        resume::check(&old, &run.config)?;
        demand_same_evaluations(&old, &run.config)
    });
    same.err().map(|error| format!("{} has other settings: {error}", run.folder.display()))
}

/// Refuses a run whose evaluations find something else than those of `planned`, or are at other steps; a plan that is longer may
/// have a longer interval.
fn demand_same_evaluations(old: &RunConfig, planned: &RunConfig) -> Result<(), ConfigError> {
    let every = |config: &RunConfig| config.learner.evaluation.every_steps;
    let is_longer = planned.iterations() > old.iterations() && every(planned) >= every(old);
    let shown = |config: &RunConfig, key: &str| config.resolved.shown(key);
    let differs = |key: &&str| match *key {
        // The description of an external environment is compared when the run resumes.
        URL => planned.environment.url.is_empty() != old.environment.url.is_empty(),
        EVERY_STEPS if is_longer => false,
        key => shown(planned, key) != shown(old, key),
    };
    match [URL, EVERY_STEPS].into_iter().chain(EVALUATED).find(differs) {
        None => Ok(()),
        Some(key) => {
            let (old, new) = (shown(old, key), shown(planned, key));
            let detail = format!("`{key}` is {new}, but the run was evaluated with {old}");
            Err(ConfigError::at(planned.resolved.origin(key), detail))
        }
    }
}

/// One line per run, and one for all.
pub(crate) fn listing(runs: &[PlannedRun], record: &Record, at_once: usize) -> String {
    let width = runs.iter().map(|run| run.name().len()).max().unwrap_or(0);
    let digits = runs.iter().map(|run| run.index.to_string().len()).max().unwrap_or(0);
    let line = |run: &PlannedRun| {
        let steps = chart::thousands(run.config.env_steps());
        let state = shown(run, record);
        format!("{:digits$}  {:width$}  {steps:>10} steps  {state}\n", run.index, run.name())
    };
    let total = runs.iter().map(|run| run.config.env_steps()).sum();
    let lines: String = runs.iter().map(line).collect();
    let (runs, steps) = (chart::count_of(runs.len() as u64, "run"), chart::thousands(total));
    format!("{lines}{runs}, {steps} steps, {at_once} at once")
}

/// The last lines of a file of JSON lines; none if it cannot be read.
pub(super) fn last_lines(path: &Path) -> Vec<Value> {
    json_lines::last_lines(path, TAIL_BYTES).unwrap_or_default()
}

/// Makes the experiment's folder. Refuses a folder in a run, and one with files of others but no run.
///
/// # Errors
/// Names the folder, and a file in it.
pub(crate) fn make_folder(
    file: &ExperimentFile,
    runs: &[PlannedRun],
    others: Others,
) -> anyhow::Result<()> {
    runs.first().map_or(Ok(()), |run| demand_outside_runs(&run.folder))?;
    let shown = file.folder.display();
    let entries = match file.folder.read_dir() {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            return Ok(durable::make_folder(&file.folder)?);
        }
        entries => entries.with_context(|| format!("cannot read {shown}"))?,
    };
    let names: Vec<String> = entries
        .filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()))
        .collect();
    let is_used = others == Others::Accepted || names.iter().any(|name| belongs(file, runs, name));
    match names.iter().find(|name| !report::is_part(name)) {
        Some(name) if !is_used => Err(Usage::new(format!(
            "{shown} contains {name} and no run of an experiment; choose another `folder`, or pass --force to use it"
        ))
        .into()),
        _ => Ok(()),
    }
}

fn shown(run: &PlannedRun, record: &Record) -> String {
    if record.holds(run) {
        return "recorded".to_owned();
    }
    match (mismatch(run).or_else(|| record.conflict(run)), run_state(run)) {
        (Some(why), _) => why,
        (None, RunFolderState::New) => "new".to_owned(),
        (None, RunFolderState::Begun { env_steps }) => {
            format!("at {}", chart::thousands(env_steps))
        }
        (None, RunFolderState::Finished) => "finished".to_owned(),
    }
}

/// Whether a file or folder of this name shows that an experiment used the folder.
fn belongs(file: &ExperimentFile, runs: &[PlannedRun], name: &str) -> bool {
    let stem = name.strip_suffix(".log").unwrap_or(name);
    name.starts_with("slurm")
        || runs.iter().any(|run| run.name() == stem)
        || RunFolder::holds_run(&file.folder.join(name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::file::ExperimentFile;
    use crate::experiment::file::tests::SAMPLE;
    use crate::experiment::plan;

    fn run_in(folder: &Path) -> PlannedRun {
        let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
        plan(&ExperimentFile { folder: folder.into(), ..file }).unwrap().remove(0)
    }

    #[test]
    fn a_run_is_finished_when_the_evaluation_of_its_last_iteration_is_in() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path());
        assert_eq!(run_state(&run), RunFolderState::New);
        std::fs::create_dir(&run.folder).unwrap();
        std::fs::write(run.folder.join("manifest.json"), "").unwrap();
        assert_eq!(run_state(&run), RunFolderState::Begun { env_steps: 0 });
        let metrics = run.folder.join("metrics.jsonl");
        let begun = "{\"kind\": \"iteration\", \"iteration\": 8, \"env_steps\": 8000}\n{\"ki";
        std::fs::write(&metrics, begun).unwrap();
        assert_eq!(run_state(&run), RunFolderState::Begun { env_steps: 8000 });
        let last =
            "{\"kind\": \"evaluation\", \"iteration\": 8, \"env_steps\": 8000, \"mean\": 1}\n";
        std::fs::write(&metrics, last).unwrap();
        let unfinished = RunFolderState::Begun { env_steps: 8000 };
        assert_eq!(run_state(&run), unfinished, "a resume writes the settings and the manifest");
        std::fs::remove_file(run.folder.join("manifest.json")).unwrap();
        let begun = RunFolder::claim_new(&run.folder).unwrap();
        let resolved = &run.config.resolved;
        let start = serde_json::json!({"config_sha256": policy::arrays::hex(&resolved.sha256())});
        begun.begin(&resolved.to_toml(), &start).unwrap();
        assert_eq!(run_state(&run), RunFolderState::Finished);
        std::fs::write(run.folder.join("config.toml"), "damaged").unwrap();
        assert_eq!(run_state(&run), unfinished);
    }

    #[test]
    fn a_folder_with_other_settings_is_not_taken_for_the_run() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path());
        assert_eq!(mismatch(&run), None);
        std::fs::create_dir(&run.folder).unwrap();
        std::fs::write(run.folder.join("manifest.json"), "").unwrap();
        let same = run.config.resolved.to_toml();
        std::fs::write(run.folder.join("config.toml"), &same).unwrap();
        assert_eq!(mismatch(&run), None);
        for (from, to, words) in [
            ("gamma = 0.99", "gamma = 0.98", "`update.gamma` cannot change"),
            ("env_steps = 8000", "env_steps = 16000", "`run.env_steps` cannot change"),
            ("episodes = 10", "episodes = 3", "`evaluation.episodes` is 10, but the run was"),
            ("sampled = false", "sampled = true", "evaluated with true"),
            ("every_steps = 4000", "every_steps = 2000", "evaluated with 2000"),
            ("url = \"\"", "url = \"http://localhost:7\"", "evaluated with \"http://localhost:7\""),
        ] {
            let other = same.replacen(from, to, 1);
            assert_ne!(other, same, "{from}");
            std::fs::write(run.folder.join("config.toml"), other).unwrap();
            let why = mismatch(&run).unwrap();
            assert!(why.contains("has other settings: ") && why.contains(words), "{why}");
        }
        let shorter = same.replacen("env_steps = 8000", "env_steps = 4000", 1);
        let with = |every: &str| {
            let config = shorter.replacen("every_steps = 4000", every, 1);
            std::fs::write(run.folder.join("config.toml"), config).unwrap();
            mismatch(&run)
        };
        assert_eq!(with("every_steps = 2000"), None, "a longer run may have a longer interval");
        let why = with("every_steps = 5000").unwrap();
        assert!(why.contains("evaluated with 5000"), "{why}");
    }

    #[test]
    fn a_record_in_the_place_of_something_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
        let file = ExperimentFile { folder: folder.path().into(), ..file };
        let runs = plan(&file).unwrap();
        let demand = |record: &str| {
            let file = ExperimentFile { record: folder.path().join(record), ..file.clone() };
            demand_own_record(&file, &runs).map_err(|why| why.to_string())
        };
        demand("record.csv").unwrap();
        for (record, words) in [
            ("", "is a folder; name another file"),
            ("new/", "is a folder"),
            ("results.md", "in the place of the experiment's own table, figure or script"),
            ("ablation.png", "in the place of the experiment's own table, figure or script"),
            ("slurm.sh", "in the place of the experiment's own table, figure or script"),
            ("ant-4x2-happo-seed1", "in the place of a run or its log"),
            ("ant-4x2-happo-seed1/record.csv", "in the place of a run or its log"),
            ("ant-4x2-happo-seed1.log", "in the place of a run or its log"),
        ] {
            let why = demand(record).unwrap_err();
            assert!(why.contains(words), "{record}: {why}");
        }
    }

    #[test]
    fn a_folder_with_files_of_others_is_used_only_on_request() {
        let folder = tempfile::tempdir().unwrap();
        let file: ExperimentFile = toml::from_str(SAMPLE).unwrap();
        let file = ExperimentFile { folder: folder.path().into(), ..file };
        let runs = plan(&file).unwrap();
        make_folder(&file, &runs, Others::Refused).unwrap();
        std::fs::write(folder.path().join("results.md"), "").unwrap();
        make_folder(&file, &runs, Others::Refused).unwrap();
        std::fs::write(folder.path().join("thesis.tex"), "").unwrap();
        let error = make_folder(&file, &runs, Others::Refused).unwrap_err().to_string();
        assert!(error.contains("contains thesis.tex and no run"), "{error}");
        make_folder(&file, &runs, Others::Accepted).unwrap();
        std::fs::write(folder.path().join("ant-4x2-happo-seed0.log"), "").unwrap();
        make_folder(&file, &runs, Others::Refused).unwrap();
        let run = RunFolder::claim_new(&folder.path().join("run")).unwrap();
        run.begin("", &serde_json::json!({"config_sha256": "aa"})).unwrap();
        let file = ExperimentFile { folder: run.path().join("study"), ..file };
        let error =
            make_folder(&file, &plan(&file).unwrap(), Others::Accepted).unwrap_err().to_string();
        assert!(error.contains("is inside the run"), "{error}");
    }
}
