//! The folder of a new run: the one that `run.dir` names, or a new one in `runs`.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Context as _;
use learner::store::durable;
use learner::store::run_folder::RunFolder;

use crate::config::run_config::RunConfig;
use crate::config::{ConfigError, Resolved, layers};
use crate::errors::Usage;
use crate::process::shell;
use crate::run::run_path;

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
            return Self::made(&run_path::default_folder(task, algorithm, seed, SystemTime::now()));
        };
        run_path::check_name(&path)?;
        let shown = path.display();
        if path.exists() && !path.is_dir() {
            let why = format!("{shown} is no folder; run.dir names the run's folder");
            return Err(Usage::new(why).into());
        }
        demand_outside_runs(&path)?;
        if RunFolder::holds_run(&path) {
            let run = shell::path(&path);
            let why = format!(
                "{shown} already contains a run; resume it with `s2mia train --resume {run}`"
            );
            return Err(Usage::new(why).into());
        }
        match RunFolder::file_of_others(&path)?.filter(|_| others == Others::Refused) {
            None => Ok(Self { path, made: false }),
            Some(file) => Err(Usage::new(format!(
                "{shown} is not empty: it contains {}; choose another run.dir, or pass --force to put the run beside it",
                run_path::name(&file)
            ))
            .into()),
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_one_second_get_folders_of_their_own_and_an_unused_one_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join("runs/a");
        let threads: Vec<_> = (0..4)
            .map(|_| {
                let name = name.clone();
                let made = move || NewFolder::made(&name).unwrap();
                std::thread::Builder::new().spawn(made).unwrap()
            })
            .collect();
        let all: Vec<_> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
        let mut names: Vec<_> = all.iter().map(|made| run_path::name(made.path())).collect();
        names.sort();
        assert_eq!(names, ["a", "a-2", "a-3", "a-4"]);
        std::fs::write(name.join("config.toml"), "").unwrap();
        drop(all);
        assert_eq!(folder.path().join("runs").read_dir().unwrap().count(), 1);
    }
}
