//! Run folders: the paths inside them, new ones, and those of the folder `runs` for commands without an argument.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Context as _;
use learner::store::run_folder::{CONFIG, MANIFEST, RunFolder, STARTS};
use learner::store::{checkpoint, durable, plain_file};
use sim::spelling::nearest;
use time::OffsetDateTime;

use crate::config::run_config::RunConfig;
use crate::config::{ConfigError, Resolved, layers};
use crate::errors::Usage;
use crate::process::shell;
use crate::process::target::{Existing, Target};

/// Longest name of a folder that file systems allow, bytes.
pub(crate) const LONGEST_NAME: usize = 255;

/// Where new runs go by default.
const RUNS: &str = "runs";

/// The learner that is asked if there is no run.
const LEARNER: &str = "http://127.0.0.1:50051";

/// Refuses a folder that contains neither a run nor a checkpoint.
pub(crate) fn demand_run(folder: &Path) -> Result<(), Usage> {
    RunFolder::demand_readable(folder).map_err(|why| Usage::new(why.to_string()))?;
    let is_run = RunFolder::was_started(folder) || RunFolder::holds_run(folder);
    if is_run || checkpoint::is_checkpoint(folder) {
        return Ok(());
    }
    let shown = folder.display();
    let meant = || match meant(folder) {
        Some(run) => format!("; did you mean `{}`?", run.display()),
        None => String::new(),
    };
    Err(Usage::new(match RunFolder::around(folder) {
        Some(run) => {
            format!("`{shown}` is no run folder, but in the run {}; name that", run.display())
        }
        None if !folder.exists() => format!("there is no run folder `{shown}`{}", meant()),
        None => {
            let missing = if folder.join(CONFIG).is_file() { MANIFEST } else { CONFIG };
            format!("`{shown}` is no run folder: it has no {missing}")
        }
    }))
}

/// The run that the path of nothing probably means: one with a similar name, beside it or in the folder `runs`.
pub(crate) fn meant(path: &Path) -> Option<PathBuf> {
    let beside = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    let known: Vec<_> =
        [beside.unwrap_or(Path::new(".")), Path::new(RUNS)].into_iter().flat_map(folders).collect();
    let name = nearest(file_name(path)?, known.iter().filter_map(|run| file_name(run)))?;
    known.iter().find(|run| file_name(run) == Some(name)).cloned()
}

/// Refuses a folder that contains no run, and the folder of a checkpoint, which does not record how it was computed.
pub(crate) fn demand_records(folder: &Path) -> Result<(), Usage> {
    if !checkpoint::is_checkpoint(folder) {
        return demand_run(folder);
    }
    let why = "is a checkpoint, which does not record how it was computed; name its run";
    Err(Usage::new(format!("{} {why}", folder.display())))
}

/// Refuses a folder that contains no run, and the folder of a checkpoint, which a resume would overwrite.
pub(crate) fn demand_resumable(folder: &Path) -> Result<(), Usage> {
    if !checkpoint::is_checkpoint(folder) {
        return demand_run(folder);
    }
    let shown = folder.display();
    Err(Usage::new(match RunFolder::around(folder) {
        Some(run) => format!(
            "{shown} is a checkpoint; `s2mia train --resume {}` resumes its run from the newest checkpoint",
            shell::path(&run)
        ),
        None => format!(
            "{shown} is a checkpoint without its run; copy it to NEW/checkpoints/iter_00000000, with its number, and \
             resume NEW"
        ),
    }))
}

/// The run folder for files of the run at `path` that `option` could name elsewhere.
///
/// # Errors
/// `path` is a checkpoint outside a run.
fn folder_of(path: &Path, option: &str) -> Result<PathBuf, Usage> {
    let run = RunFolder::of(path);
    if !checkpoint::is_checkpoint(&run) {
        return Ok(run);
    }
    Err(Usage::new(format!(
        "{} is a checkpoint without its run; name the file to write with {option}",
        path.display()
    )))
}

/// The file that a command writes for the run at `path`: the one that `option` names, or `own` in the run's folder. A team
/// that comes with the program has no folder; its file is named for the task.
///
/// # Errors
/// As of [`Target`]; or `path` is a checkpoint outside a run.
pub(crate) fn target(
    path: &Path,
    (option, named): (&str, Option<&Path>),
    own: &Path,
    existing: Existing,
) -> anyhow::Result<Target> {
    let extension = own.extension().unwrap_or_default().to_string_lossy();
    let file = match named {
        Some(file) => file.to_path_buf(),
        None if !path.exists() => PathBuf::from(format!("{}.{extension}", path.display())),
        None => {
            let file = folder_of(path, option)?.join(own);
            file.parent().map_or(Ok(()), durable::make_folder)?;
            file
        }
    };
    Ok(Target::named(option, &file, &extension, existing)?)
}

/// What is in a folder under names that `belong`, in the order of the names.
pub(crate) fn files(folder: &Path, belong: fn(&str) -> bool) -> io::Result<Vec<PathBuf>> {
    let paths = folder.read_dir()?.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<_> = paths.filter(|path| file_name(path).is_some_and(belong)).collect();
    paths.sort();
    Ok(paths)
}

/// As [`files`], but refuses pipes and devices, which would block.
pub(crate) fn plain_files(folder: &Path, belong: fn(&str) -> bool) -> io::Result<Vec<PathBuf>> {
    let paths = files(folder, belong)?;
    let waits = |path: &&PathBuf| path.metadata().is_ok_and(|found| !found.is_file());
    match paths.iter().find(waits).and_then(|path| Some((path, plain_file::refusal(path)?))) {
        None => Ok(paths),
        Some((path, why)) => Err(io::Error::other(format!("{}: {why}", path.display()))),
    }
}

/// The name of a file, if it is text.
pub(crate) fn file_name(path: &Path) -> Option<&str> {
    path.file_name().and_then(|name| name.to_str())
}

/// Last part of the path.
pub(crate) fn name(folder: &Path) -> String {
    let resolved = folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf());
    resolved.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned()
}

/// Refuses the name of a new run if logs and clients cannot show it.
pub(crate) fn check_name(folder: &Path) -> Result<(), Usage> {
    let name = name(folder);
    let refused = |error| Usage::new(format!("run.dir: the name {name:?} {error}"));
    proto::name::check(&name, LONGEST_NAME).map_err(refused)
}

/// `runs/<task>-<algorithm>-seed<seed>-<UTC time>`. An external program may name the task, so only its letters, digits,
/// dots and underscores are kept.
pub(crate) fn default_folder(task: &str, algorithm: &str, seed: u64, now: SystemTime) -> PathBuf {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "._".contains(c) { c } else { '-' };
    let task = task.chars().map(plain).collect::<String>();
    PathBuf::from(format!("runs/{task}-{algorithm}-seed{seed}-{}", utc(now.into())))
}

/// `of`, or the run of the checkpoint `of`, or if it is empty the newest run that has a learner, else the newest run, else
/// the default learner.
pub(crate) fn or_newest(of: &str) -> Result<String, Usage> {
    let shown = |run: PathBuf| run.display().to_string();
    match of {
        "" => Ok(newest(Path::new(RUNS)).map_or_else(|| LEARNER.to_owned(), shown)),
        of => shell::expanded_text(of).map(|of| shown(RunFolder::of(Path::new(&of)))),
    }
}

/// The newest run of the folder `runs`, which a command uses if none is named.
pub(crate) fn newest_run() -> anyhow::Result<PathBuf> {
    let none = || Usage::new(format!("there is no run in ./{RUNS}; name a run folder or a task"));
    Ok(newest(Path::new(RUNS)).ok_or_else(none)?)
}

/// All runs of the folder `runs`, in the order of their names.
pub(crate) fn all_runs() -> Result<Vec<PathBuf>, Usage> {
    let mut found: Vec<_> = folders(Path::new(RUNS)).collect();
    found.sort();
    if found.is_empty() {
        return Err(Usage::new(format!("there is no run in ./{RUNS}; name the run folders")));
    }
    Ok(found)
}

/// What a folder may contain before a run begins in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Others {
    /// Nothing.
    Refused,
    /// Files of others, which stay.
    Accepted,
}

/// The folder of a new run. If it was made, it is removed when this is dropped, unless something is in it.
#[derive(Debug)]
pub(crate) struct NewFolder {
    path: PathBuf,
    made: bool,
}

impl NewFolder {
    /// The folder for a run of `config`.
    ///
    /// # Errors
    /// The folder contains a run, is in one, or has files of others that are not accepted.
    pub(crate) fn of(config: &RunConfig, task: &str, others: Others) -> anyhow::Result<Self> {
        let Some(path) = named(&config.resolved)? else {
            let algorithm = config.resolved.text("algorithm");
            let seed = config.run.seed;
            return Self::made(&default_folder(task, algorithm, seed, SystemTime::now()));
        };
        check_name(&path)?;
        let shown = path.display();
        if path.exists() && !path.is_dir() {
            let why = format!("{shown} is no folder; run.dir names the run's folder");
            return Err(Usage::new(why).into());
        }
        demand_outside_runs(&path)?;
        if RunFolder::holds_run(&path) {
            let run = shell::path(&path);
            let why = format!(
                "{shown} already contains a run; resume it with `s2mia train --resume {run}`, or name another folder in run.dir"
            );
            return Err(Usage::new(why).into());
        }
        let (found, advice) = match others {
            Others::Refused => (
                RunFolder::file_of_others(&path)?,
                "choose another run.dir, or pass --force to put the run beside it",
            ),
            Others::Accepted => (
                RunFolder::in_place_of_own(&path)?,
                "the run would replace it: move it away, or choose another run.dir",
            ),
        };
        let Some(file) = found else { return Ok(Self { path, made: false }) };
        let file = name(&file);
        Err(Usage::new(format!("{shown} is not empty: it contains {file}; {advice}")).into())
    }

    /// Makes a folder that no other process has: `name`, or with a number behind it.
    fn made(name: &Path) -> anyhow::Result<Self> {
        demand_outside_runs(name)?;
        if let Some(runs) = name.parent() {
            durable::make_folder(runs)?;
        }
        let mut path = name.to_path_buf();
        let mut number = 1;
        loop {
            match std::fs::create_dir(&path) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                    number += 1;
                    path = PathBuf::from(format!("{}-{number}", name.display()));
                }
                made => {
                    made.with_context(|| format!("cannot make {}", path.display()))?;
                    return Ok(Self { path, made: true });
                }
            }
        }
    }

    /// Its path.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if self.made {
            // It stays if the run has begun.
            let _removed = std::fs::remove_dir(&self.path);
        }
    }
}

/// The folder that `run.dir` names, if it names one.
pub(crate) fn named(resolved: &Resolved) -> Result<Option<PathBuf>, ConfigError> {
    let refused = |detail: &str| ConfigError::refused(resolved, &["run.dir"], detail);
    match resolved.text("run.dir") {
        "" if layers::is_of_this_command(resolved.origin("run.dir")) => {
            Err(refused("it is empty; without it the run gets a new folder in `runs`"))
        }
        "" => Ok(None),
        given => match shell::expanded(Path::new(given)) {
            Ok(path) => Ok(Some(path)),
            Err(why) => Err(refused(&why.to_string())),
        },
    }
}

/// Refuses a folder in a run, where its files would mix with the run's.
pub(crate) fn demand_outside_runs(path: &Path) -> Result<(), Usage> {
    RunFolder::demand_outside_runs(path).map_err(|why| Usage::new(why.to_string()))
}

/// `20260131-235959`, in UTC.
fn utc(time: OffsetDateTime) -> String {
    let ((year, month, day), (hour, minute, second)) = (time.to_calendar_date(), time.to_hms());
    format!("{year:04}{:02}{day:02}-{hour:02}{minute:02}{second:02}", u8::from(month))
}

fn newest(runs: &Path) -> Option<PathBuf> {
    folders(runs).max_by_key(|folder| {
        let is_live = matches!(RunFolder::is_locked(folder), Ok(true));
        (is_live, started(folder), folder.clone())
    })
}

fn folders(runs: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = runs.read_dir().into_iter().flatten();
    let folders = entries.filter_map(|entry| Some(entry.ok()?.path()));
    folders.filter(|folder| RunFolder::holds_run(folder))
}

/// When the newest learner of a run started.
fn started(folder: &Path) -> SystemTime {
    let starts = folder.join(STARTS).metadata().and_then(|file| file.modified());
    starts.unwrap_or(SystemTime::UNIX_EPOCH)
}

#[cfg(test)]
mod tests;
