//! `s2mia page`: one web page with the curves of several runs, from nothing but their folders.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use learner::metrics::Curves;
use learner::{Hosts, Overlay, Page};
use tokio::net::TcpListener;

use crate::cli::RunsPageArguments;
use crate::errors::Usage;
use crate::listening::demand_loopback;
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
    let folders = if arguments.runs.is_empty() { newest::all()? } else { arguments.runs };
    folders.iter().try_for_each(|folder| run_path::demand_run(folder))?;
    let followed = Mutex::new(Followed::of(&folders));
    let look = move || followed.lock().unwrap_or_else(PoisonError::into_inner).look();
    runtime()?.block_on(async {
        let listener = TcpListener::bind(arguments.listen).await.map_err(|error| {
            let advice = "choose another port, or 0 for any free one";
            Usage::new(format!("--listen {}: {error}; {advice}", arguments.listen))
        })?;
        output::line(format!("page: http://{}", listener.local_addr()?));
        let page = Page { listener, hosts: Hosts::with(&arguments.page_host), tls: None };
        learner::serve_overlay(page, look).await;
        Ok(())
    })
}

/// Several runs, whose metrics are read when somebody asks.
struct Followed {
    runs: Vec<(Growing, String, Arc<Curves>)>,
    version: u64,
    looked: Option<Instant>,
}

impl Followed {
    fn of(folders: &[PathBuf]) -> Self {
        let runs = folders.iter().zip(names(folders)).map(|(folder, name)| {
            (Growing::of(run_path::metrics_file(folder)), name, Arc::default())
        });
        Self { runs: runs.collect(), version: 0, looked: None }
    }

    /// The curves, read again if the last look is old enough.
    fn look(&mut self) -> Overlay {
        if self.looked.is_none_or(|looked| looked.elapsed() >= LOOK_AGAIN) {
            self.follow();
            self.looked = Some(Instant::now());
        }
        let runs = self.runs.iter().map(|(_, name, curves)| (name.clone(), Arc::clone(curves)));
        Overlay { version: self.version, runs: runs.collect() }
    }

    fn follow(&mut self) {
        for (growing, _, curves) in &mut self.runs {
            if growing.follow() {
                *curves = Arc::new(growing.get().clone());
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
        assert_eq!((version, runs[0].1.lines()), (2, 2));
    }
}
