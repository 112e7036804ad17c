//! `s2mia page`: one web page with the curves of several runs, from nothing but their folders.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use learner::metrics::Curves;
use learner::run_folder::RunFolder;
use learner::{OverlaidRun, Overlay, Page};
use tokio::net::TcpListener;

use crate::cli::RunsPageArguments;
use crate::errors::Usage;
use crate::figures::learning_curve;
use crate::listening::demand_loopback;
use crate::page;
use crate::process::{output, runtime};
use crate::run::growing::Growing;
use crate::run::{newest, run_path};

/// How often the metrics are read, at most.
const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// Serves the page until the process is stopped.
pub(super) fn run(arguments: RunsPageArguments) -> anyhow::Result<()> {
    if !arguments.insecure_allow_remote_page {
        let permission = "pass --insecure-allow-remote-page to allow that, and --page-host with \
             the names they use";
        demand_loopback("--listen", arguments.listen, permission)?;
    }
    let hosts = page::hosts(&arguments.page_host)?;
    let folders = if arguments.runs.is_empty() { newest::all()? } else { arguments.runs };
    folders.iter().try_for_each(|folder| run_path::demand_run(folder))?;
    let folders: Vec<_> = folders.iter().map(|folder| RunFolder::of(folder)).collect();
    let followed = Mutex::new(Followed::of(&folders));
    let look = move || followed.lock().unwrap_or_else(PoisonError::into_inner).look();
    runtime()?.block_on(async {
        let listener = TcpListener::bind(arguments.listen).await.map_err(|error| {
            let advice = "choose another port, or 0 for any free one";
            Usage::new(format!("--listen {}: {error}; {advice}", arguments.listen))
        })?;
        output::line(format!("page: http://{}", listener.local_addr()?));
        let page = Page { listener, hosts, tls: None };
        learner::serve_overlay(page, look).await;
        Ok(())
    })
}

/// Several runs, whose metrics are read when somebody asks.
struct Followed {
    runs: Vec<FollowedRun>,
    version: u64,
    looked: Option<Instant>,
}

struct FollowedRun {
    name: String,
    /// Name of its group of seeds, or why its settings cannot be read.
    group: Result<String, String>,
    growing: Growing,
    curves: Arc<Curves>,
}

impl FollowedRun {
    fn shown(&self) -> OverlaidRun {
        let (name, curves) = (self.name.clone(), Arc::clone(&self.curves));
        let troubles = self.group.as_ref().err().cloned().into_iter().chain(self.growing.trouble());
        let troubles = troubles.collect::<Vec<_>>().join("; ");
        let trouble = Some(troubles).filter(|troubles| !troubles.is_empty());
        OverlaidRun { name, group: self.group.clone().ok(), trouble, curves }
    }
}

impl Followed {
    fn of(folders: &[PathBuf]) -> Self {
        let all = folders.iter().zip(names(folders)).zip(groups(folders));
        let runs = all.map(|((folder, name), group)| {
            let growing = Growing::of(run_path::metrics_file(folder));
            FollowedRun { name, group, growing, curves: Arc::default() }
        });
        Self { runs: runs.collect(), version: 0, looked: None }
    }

    /// The curves, read again if the last look is old enough.
    fn look(&mut self) -> Overlay {
        if self.looked.is_none_or(|looked| looked.elapsed() >= LOOK_AGAIN) {
            self.follow();
            self.looked = Some(Instant::now());
        }
        let runs = self.runs.iter().map(FollowedRun::shown).collect();
        Overlay { version: self.version, runs }
    }

    fn follow(&mut self) {
        for run in &mut self.runs {
            if run.growing.follow() {
                run.curves = Arc::new(run.growing.get().clone());
                self.version += 1;
            }
        }
    }
}

/// The folders' own names, or their paths as given if two names are equal.
fn names(folders: &[PathBuf]) -> Vec<String> {
    let short: Vec<_> = folders.iter().map(|folder| run_path::name(folder)).collect();
    let mut distinct = short.clone();
    distinct.sort();
    distinct.dedup();
    if distinct.len() == short.len() {
        return short;
    }
    folders.iter().map(|folder| folder.display().to_string()).collect()
}

/// For each run the name of its group, which all runs have that differ from it only in their seed, or why its settings
/// cannot be read.
fn groups(folders: &[PathBuf]) -> Vec<Result<String, String>> {
    let read = |folder: &Path| {
        learning_curve::without_points(folder)
            .map_err(|error| format!("its settings are unknown, so it is in no group: {error:#}"))
    };
    let found: Vec<_> = folders.iter().map(|folder| read(folder)).collect();
    let known: Vec<_> = found.iter().flatten().cloned().collect();
    let mut names = learning_curve::tasks_and_variants(&known).into_iter();
    let named =
        |run: Result<_, String>| run.map(|_| names.next().expect("each known run has a name"));
    found.into_iter().map(named).collect()
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn runs_with_the_same_name_are_named_by_their_paths() {
        let folders = |all: &[&str]| all.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(names(&folders(&["a/x", "a/y"])), ["x", "y"]);
        assert_eq!(names(&folders(&["a/x", "b/x"])), ["a/x", "b/x"]);
    }

    #[test]
    fn only_a_growing_run_changes_the_version() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let line = "{\"kind\":\"iteration\",\"env_steps\":40,\"a\":1}\n";
        std::fs::write(&path, line).unwrap();
        let mut followed = Followed::of(&[folder.path().to_path_buf()]);
        assert_eq!(followed.look().version, 1);
        followed.follow();
        assert_eq!(followed.look().version, 1);
        let mut file = std::fs::File::options().append(true).open(&path).unwrap();
        file.write_all(line.as_bytes()).unwrap();
        followed.follow();
        let Overlay { version, runs } = followed.look();
        assert_eq!((version, runs[0].curves.lines()), (2, 2));
    }
}
