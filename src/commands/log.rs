//! `s2mia log`: checks trajectory logs, and that the simulator reproduces them.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use learner::store::run_folder::{CONFIG, LOGS, RunFolder};
use recording::trajectory_log::{
    self, LogError, ReadShares, Replayed, is_log_name, read_bytes, read_shares,
};

use crate::errors::{Incomplete, Usage};
use crate::figures::chart::{count_of, thousands};
use crate::process::output;
use crate::progress::WorkProgress;
use crate::run::run_path;

/// `s2mia log`
#[derive(Args, Debug)]
pub(crate) struct LogArguments {
    /// MCAP files, or folders with trajectories-*.mcap.
    #[arg(required = true, value_name = "FILE | DIR")]
    pub(crate) files: Vec<PathBuf>,
    /// Also step the simulator with the logged actions and compare every observation, state and reward, bit for bit.
    #[arg(long)]
    pub(crate) replay: bool,
}

/// Ends with status 1 if a file is damaged or a replayed step differs, with 3 if only data is missing. All files are checked.
pub(super) fn run(arguments: &LogArguments) -> anyhow::Result<()> {
    let paths = paths(&arguments.files)?;
    let all = paths.iter().map(|path| size(path)).sum();
    let mut done = 0;
    let progress = WorkProgress::new();
    let mut gaps = Gaps::default();
    let mut failures = Vec::new();
    for path in &paths {
        let checked = in_file(path, read_bytes(path)).and_then(|bytes| {
            let log = verify(path, &bytes, &progress)?;
            gaps.add(&log);
            if arguments.replay { replay(path, &bytes, (done, all), &progress) } else { Ok(()) }
        });
        failures.extend(checked.err());
        done += size(path);
        progress.reach(done, all, || format!("read {}", run_path::name(path)));
    }
    if let Some(last) = failures.pop() {
        failures
            .iter()
            .for_each(|why| output::error(format!("error: {}", actor::causes(why.as_ref()))));
        return Err(last);
    }
    gaps.demand_none()
}

/// What is missing in all files together.
#[derive(Default, PartialEq)]
struct Gaps {
    /// Steps of shares that were cut off.
    cut_off: u64,
    /// Shares that the actors could not write.
    lost: u64,
    /// Shares that were written and are no longer there.
    missing: u64,
    /// Files whose end is missing, which states their shares.
    endless: u64,
}

impl Gaps {
    fn add(&mut self, log: &ReadShares) {
        self.cut_off += log.torn_steps;
        self.lost += log.lost_shares().unwrap_or(0);
        self.missing += log.missing_shares().unwrap_or(0);
        self.endless += u64::from(log.missing_shares().or(log.lost_shares()).is_none());
    }

    fn demand_none(&self) -> anyhow::Result<()> {
        if *self == Self::default() {
            return Ok(());
        }
        let mut gaps = vec![
            format!("{} of shares that were cut off", count_of(self.cut_off, "step")),
            count_of(self.lost, "lost share"),
        ];
        if self.missing > 0 {
            gaps.push(format!("{} of the written ones missing", count_of(self.missing, "share")));
        }
        if self.endless > 0 {
            let files = count_of(self.endless, "file");
            gaps.push(format!("{files} without the end that states the number of shares"));
        }
        Err(Incomplete(gaps.join(", ")).into())
    }
}

/// Checks that a file is undamaged, and prints what it holds.
fn verify(path: &Path, bytes: &[u8], progress: &WorkProgress) -> anyhow::Result<ReadShares> {
    let mut steps = 0;
    let read = read_shares(bytes, |share| {
        steps += share.steps.len() as u64;
        Ok(())
    });
    let log = in_file(path, read)?;
    let lost = match log.lost_shares() {
        Some(lost) => format!("{} lost by the actor", count_of(lost, "share")),
        None => "its end, which states the shares that were lost, is missing".to_owned(),
    };
    progress.print(format!(
        "{}: checksums and schemas are right: {}, {}; {lost}",
        path.display(),
        count_of(log.shares, "share"),
        count_of(steps, "step"),
    ));
    Ok(log)
}

/// Replays a file, of whose logs' `all` bytes `done` are in earlier files; fails at the first step that differs.
fn replay(
    path: &Path,
    bytes: &[u8],
    (done, all): (u64, u64),
    progress: &WorkProgress,
) -> anyhow::Result<()> {
    let replayed = trajectory_log::replay(bytes, |step, steps| {
        let here = bytes.len() as f64 * step as f64 / steps.max(1) as f64;
        let name = run_path::name(path);
        let place = || format!("{name}, step {} of {}", thousands(step), thousands(steps));
        progress.reach(done + here as u64, all, place);
    });
    let Replayed { shares, steps, difference, other_program } = in_file(path, replayed)?;
    let shown = path.display();
    let shares = count_of(shares, "share");
    let steps = count_of(steps, "step");
    progress.print(format!("{shown}: {steps} in {shares}, equal bit for bit"));
    match (difference, other_program) {
        (None, _) => Ok(()),
        (Some(difference), Some(_)) => anyhow::bail!(
            "{shown}: {difference}; it was logged by a program that computes other numbers"
        ),
        (Some(difference), None) => anyhow::bail!("{shown}: {difference}"),
    }
}

/// The trajectory logs in `files` and folders, each once, ordered by name within a folder.
fn paths(files: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut paths: Vec<PathBuf> = Vec::new();
    for given in files {
        let found = if given.is_dir() { in_folder(given)? } else { vec![given.clone()] };
        for path in found {
            if !paths.contains(&path) {
                paths.push(path);
            }
        }
    }
    Ok(paths)
}

/// Bytes of a file, for progress; 0 if it cannot be read, which reading it reports.
fn size(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |file| file.len())
}

/// The logs of a folder; for a run folder, those of the run.
fn in_folder(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let run = RunFolder::of(folder);
    let logs = run.join(LOGS);
    let is_run = run.join(CONFIG).is_file() && logs.is_dir();
    let folder = if is_run { &logs } else { folder };
    let found = |belong: fn(&str) -> bool| {
        let paths = run_path::files(folder, belong);
        paths.with_context(|| format!("cannot read {}", folder.display()))
    };
    let paths = found(is_log_name)?;
    if paths.is_empty() {
        let recording = match found(|name| name.ends_with(".mcap"))?.pop() {
            Some(file) => format!("; name a file such as {} for a recording", file.display()),
            None => String::new(),
        };
        let shown = folder.display();
        let why = format!("no trajectories-*.mcap in {shown}; log.episodes makes some{recording}");
        return Err(Usage::new(why).into());
    }
    Ok(paths)
}

/// Adds the path of the file to an error.
fn in_file<T>(path: &Path, result: Result<T, LogError>) -> anyhow::Result<T> {
    result.with_context(|| path.display().to_string())
}
