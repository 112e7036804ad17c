//! What the folder of a run records of its results, checked as far as that needs no computation: its settings, the lines of
//! provenance and metrics, and its checkpoints belong together, and nothing of them is missing or changed.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use learner::store::checkpoint::{self, Loaded, SETTINGS};
use learner::store::json_lines::JsonLinesReader;
use learner::store::plain_file;
use learner::store::run_folder::{CONFIG, MANIFEST, METRICS, PROVENANCE, RunFolder, STARTS};
use proto::Digest;
use proto::name::printable;
use serde_json::Value;

use crate::config::ConfigError;
use crate::config::run_config::RunConfig;
use crate::figures::chart;
use crate::run::stored::{own_settings, settings_in};
use crate::run::{build_of, start};

/// The lines of a file by their iteration.
pub(crate) type Lines = BTreeMap<u64, Value>;

/// The records of a run.
#[derive(Debug)]
pub(crate) struct Recorded {
    /// Folder of the run.
    pub(crate) folder: PathBuf,
    /// Content of `starts.jsonl`, to which each start of a learner adds a line.
    starts: Option<Vec<u8>>,
    /// Content of `manifest.json`.
    pub(crate) manifest: Value,
    /// Its settings.
    pub(crate) config: RunConfig,
    /// The lines of `provenance.jsonl`, of every iteration from 1 on.
    pub(crate) provenance: Lines,
    /// The lines of iterations in `metrics.jsonl`, of the same ones.
    pub(crate) metrics: Lines,
    /// The lines of evaluations in `metrics.jsonl`, of none after those iterations.
    pub(crate) evaluations: Lines,
    /// Iterations of the checkpoints from 1 on, ascending.
    pub(crate) checkpoints: Vec<u64>,
}

impl Recorded {
    /// Reads the records of the run in `folder`. [`Self::checkpoint`] reads and checks a checkpoint.
    ///
    /// # Errors
    /// Names the first file that is missing, damaged or does not belong to the others, or the learner that works on the run.
    pub(crate) fn read(folder: &Path) -> anyhow::Result<Self> {
        let starts = starts(folder);
        RunFolder::demand_unused(folder)?;
        let manifest = RunFolder::recorded(folder).with_context(|| {
            let file = folder.join(MANIFEST);
            format!("{} is missing, or it has been changed since it was written", file.display())
        })?;
        let config = own_settings(folder)?;
        let file = folder.join(PROVENANCE);
        let provenance = of_kind(&file, &lines(&file)?, "iteration")?;
        let last = last(&provenance);
        demand_whole(&file, &provenance, last)?;
        let file = folder.join(METRICS);
        let lines = lines(&file)?;
        let metrics = of_kind(&file, &lines, "iteration")?;
        demand_whole(&file, &metrics, last)?;
        let evaluations = of_kind(&file, &lines, "evaluation")?;
        demand_only(&file, &evaluations, 0..=last)?;
        let others = lines.len() - metrics.len() - evaluations.len();
        ensure!(others == 0, "{} has {others} lines of no known kind", file.display());
        let mut checkpoints = checkpoint::all(folder)?;
        // That of iteration 0 holds no more than the seed.
        checkpoints.retain(|iteration| *iteration > 0);
        let folder = folder.to_path_buf();
        Ok(Self { folder, starts, manifest, config, provenance, metrics, evaluations, checkpoints })
    }

    /// Runs `work` on the records. If a learner changed the run meanwhile, an error says so.
    ///
    /// # Errors
    /// As `work`.
    pub(crate) fn undisturbed<T>(
        &self,
        work: impl FnOnce(&Self) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let done = work(self);
        if starts(&self.folder) == self.starts {
            return done;
        }
        done.context("a learner worked on it meanwhile; repeat the command when it has ended")
    }

    /// Refuses a run whose `starts.jsonl` has no line, a line of another run or a line without a build, or whose copy of the
    /// policies from which it started is damaged or gone.
    pub(crate) fn demand_starts(&self) -> anyhow::Result<()> {
        let file = self.folder.join(STARTS);
        for (start, number) in lines(&file)?.iter().zip(1..) {
            let place = format!("{}, line {number}", file.display());
            for key in OF_ALL_STARTS {
                let (found, recorded) = (&start[key], &self.manifest[key]);
                ensure!(found == recorded, "{place}: {key} is {found}, {MANIFEST} has {recorded}");
            }
            for key in ["version", "git_commit"] {
                ensure!(start[key].is_string(), "{place}: {key} is missing");
            }
        }
        start::demand_kept(&self.config.resolved, &self.folder)
    }

    /// Refuses a checkpoint that is damaged or does not belong to the other records.
    pub(crate) fn demand_checkpoints(&self) -> anyhow::Result<()> {
        self.checkpoints.iter().try_for_each(|iteration| self.checkpoint(*iteration).map(drop))
    }

    /// The last iteration with a line in `provenance.jsonl`.
    pub(crate) fn last(&self) -> u64 {
        last(&self.provenance)
    }

    /// What to say of records that end before the run of these settings does, after a semicolon.
    pub(crate) fn unfinished(&self) -> String {
        let whole = self.config.iterations();
        if self.last() >= whole {
            return String::new();
        }
        let whole = chart::count_of(whole, "iteration");
        format!("; its settings have {whole}, so it was stopped, or its records were cut off")
    }

    /// Hash of the run's semantic settings.
    pub(crate) fn config_sha256(&self) -> Digest {
        Digest(self.config.resolved.sha256())
    }

    /// The checkpoint of an iteration, with the settings, weights and policies of this run.
    pub(crate) fn checkpoint(&self, iteration: u64) -> anyhow::Result<Loaded> {
        let loaded = checkpoint::load(&checkpoint::place(&self.folder, iteration))?;
        let provenance = self.folder.join(PROVENANCE);
        let line = |iteration: u64| self.provenance.get(&iteration);
        let (weights, policy) =
            (loaded.checkpoint.weights_sha256(), Digest::of(&loaded.checkpoint.policy).to_string());
        let of_weights = line(iteration).map(|line| &line["weights_sha256"]);
        let of_weights = of_weights.with_context(|| {
            let place = loaded.path.display();
            format!("{} has no line of iteration {iteration} of {place}", provenance.display())
        })?;
        let acting = line(iteration + 1).map(|line| &line["behaviour"]["digest"]);
        let config = Value::from(self.config_sha256().to_string());
        for (what, found, file, recorded) in [
            ("settings", &loaded.manifest.config_sha256, CONFIG, Some(&config)),
            ("weights", &weights, PROVENANCE, Some(of_weights)),
            ("policies", &policy, PROVENANCE, acting),
        ] {
            let Some(recorded) = recorded.filter(|recorded| **recorded != **found) else {
                continue;
            };
            let (place, file) = (loaded.path.display(), self.folder.join(file));
            let file = file.display();
            anyhow::bail!("the {what} in {place} have the SHA-256 {found}, {file} has {recorded}");
        }
        Ok(loaded)
    }

    /// The settings with which the iterations after that of a checkpoint were computed; 0: those of the run.
    pub(crate) fn settings_after(&self, iteration: u64) -> Result<RunConfig, ConfigError> {
        match iteration {
            0 => Ok(self.config.clone()),
            _ => settings_in(&checkpoint::place(&self.folder, iteration).join(SETTINGS)),
        }
    }

    /// Versions and commits of the programs that computed the run.
    pub(crate) fn builds(&self) -> anyhow::Result<BTreeSet<String>> {
        let starts = all_lines(&self.folder.join(STARTS))?;
        // Others may have written the file.
        let build = |start: &Value| printable(&build_of(start));
        Ok(starts.iter().chain([&self.manifest]).map(build).collect())
    }
}

/// What all starts of a run have in common.
const OF_ALL_STARTS: [&str; 7] =
    ["algorithm", "config_sha256", "environment", "environment_states", "program", "seed", "task"];

/// The last iteration.
fn last(lines: &Lines) -> u64 {
    lines.last_key_value().map_or(0, |(iteration, _)| *iteration)
}

/// The lines of a file, which is there and whole.
fn lines(file: &Path) -> anyhow::Result<Vec<Value>> {
    let lines = all_lines(file)?;
    ensure!(!lines.is_empty(), "{} is missing or has no line", file.display());
    Ok(lines)
}

/// The lines of a file, if there is one. A crash may have left half of the last one, which does not count.
pub(crate) fn all_lines(file: &Path) -> anyhow::Result<Vec<Value>> {
    let read = JsonLinesReader::of(file.to_path_buf()).more();
    let read = read.with_context(|| format!("cannot read {}", file.display()))?;
    match read.first_damaged {
        None => Ok(read.lines),
        Some(line) => anyhow::bail!("{}, line {line}: is no JSON object", file.display()),
    }
}

/// Content of the run's `starts.jsonl`, if it can be read.
fn starts(folder: &Path) -> Option<Vec<u8>> {
    plain_file::read(&folder.join(STARTS)).ok()
}

/// The lines of this kind; a line without a kind is one of an iteration.
pub(crate) fn of_kind(file: &Path, lines: &[Value], kind: &str) -> anyhow::Result<Lines> {
    let mut found = Lines::new();
    for line in lines.iter().filter(|line| line["kind"].as_str().unwrap_or("iteration") == kind) {
        let iteration = line["iteration"].as_u64();
        let iteration = iteration.with_context(|| {
            format!("{} has a line without an iteration: {line}", file.display())
        })?;
        let is_new = found.insert(iteration, line.clone()).is_none();
        ensure!(is_new, "{} has a second {kind} line for iteration {iteration}", file.display());
    }
    Ok(found)
}

/// Refuses lines other than those of the iterations 1 to `last`, and if one of them is missing.
fn demand_whole(file: &Path, lines: &Lines, last: u64) -> anyhow::Result<()> {
    match (1..=last).find(|iteration| !lines.contains_key(iteration)) {
        Some(lost) => anyhow::bail!("{} has no line of iteration {lost}", file.display()),
        None => demand_only(file, lines, 1..=last),
    }
}

/// Refuses lines of iterations that the run has not.
fn demand_only(file: &Path, lines: &Lines, known: RangeInclusive<u64>) -> anyhow::Result<()> {
    match lines.keys().find(|iteration| !known.contains(iteration)) {
        Some(other) => anyhow::bail!(
            "{} has a line of iteration {other}, {PROVENANCE} has iterations 1 to {}; if a crash left it, a resume removes it",
            file.display(),
            known.end()
        ),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_says_that_a_learner_worked_on_the_run_meanwhile_only_where_one_started() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(STARTS);
        std::fs::write(&file, "{}\n").unwrap();
        let recorded = Recorded {
            folder: folder.path().to_path_buf(),
            starts: starts(folder.path()),
            manifest: Value::Null,
            config: RunConfig::with(&[]).unwrap(),
            provenance: Lines::new(),
            metrics: Lines::new(),
            evaluations: Lines::new(),
            checkpoints: Vec::new(),
        };
        let failure = || anyhow::anyhow!("a line differs");
        let alone = recorded.undisturbed(|_| Err::<(), _>(failure())).unwrap_err();
        assert_eq!(alone.to_string(), "a line differs");
        std::fs::write(&file, "{}\n{}\n").unwrap();
        recorded.undisturbed(|_| Ok(())).unwrap();
        let disturbed = recorded.undisturbed(|_| Err::<(), _>(failure())).unwrap_err();
        assert!(disturbed.to_string().starts_with("a learner worked on it meanwhile"));
    }
}
