//! `s2mia train --verify-determinism`: three short runs, with different numbers of actors and a stop, must end in the same
//! state.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Context as _;
use learner::store::checkpoint;

use crate::config::run_config::RunConfig;
use crate::process::output;
use crate::run::SettingsArguments;

/// Name of a trial, its number of actors, and the iteration after which it is stopped and resumed.
const TRIALS: [(&str, usize, Option<u64>); 3] =
    [("1 actor", 1, None), ("2 actors", 2, None), ("2 actors, stopped and resumed", 2, Some(1))];

/// Checks the settings, runs all trials for `iterations` and prints the final state of each.
///
/// # Errors
/// A setting is refused, a trial failed, or the states differ.
pub(crate) fn verify(settings: &SettingsArguments, iterations: u64) -> anyhow::Result<()> {
    // A trial would report a setting that cannot be used as its own failure.
    RunConfig::of(&settings.request())?;
    let place = Scratch::make()?;
    let mut states = Vec::new();
    for (index, (name, actors, stop)) in TRIALS.into_iter().enumerate() {
        let folder = place.0.join(index.to_string());
        let trial = Trial { settings, folder: &folder, actors };
        trial.play(stop, iterations).with_context(|| format!("trial `{name}` failed"))?;
        let state = checkpoint::load_newest(&folder)?.saved().state_sha256;
        output::line(format!("{name:<31} {state}"));
        states.push(state);
    }
    check_equal(&states)?;
    output::line(format!("deterministic over {iterations} iterations: all states are equal"));
    Ok(())
}

fn check_equal(states: &[String]) -> anyhow::Result<()> {
    match states.iter().position(|state| *state != states[0]) {
        None => Ok(()),
        Some(index) => anyhow::bail!(
            "not deterministic: `{}` and `{}` end in different states",
            TRIALS[0].0,
            TRIALS[index].0
        ),
    }
}

struct Trial<'a> {
    settings: &'a SettingsArguments,
    folder: &'a Path,
    actors: usize,
}

impl Trial<'_> {
    /// Trains a new run for `iterations`, with a stop and a resume after the iteration `stop` if there is one.
    fn play(&self, stop: Option<u64>, iterations: u64) -> anyhow::Result<()> {
        train(&mut self.command(stop.unwrap_or(iterations))?)?;
        match stop {
            Some(_) => train(self.command(iterations)?.arg("--resume").arg(self.folder)),
            None => Ok(()),
        }
    }

    /// A training process. A resume has all settings again, which override environment variables as at the start.
    fn command(&self, iterations: u64) -> anyhow::Result<Command> {
        let files = &self.settings.files;
        let files = files.iter().flat_map(|file| ["--config".as_ref(), file.as_os_str()]);
        let mut command =
            Command::new(std::env::current_exe().context("cannot find this program")?);
        command
            .arg("train")
            .args(self.settings.written())
            .args(files)
            .arg(format!("run.dir={}", self.folder.display()))
            .arg(format!("run.iterations={iterations}"))
            .arg(format!("run.actors={}", self.actors))
            .arg("evaluation.every_steps=0");
        Ok(command)
    }
}

/// Runs a training process to its end; its log is that of this process.
fn train(command: &mut Command) -> anyhow::Result<()> {
    let status = command.args(["--page", "off"]).stdout(Stdio::null()).status();
    let status = status.context("cannot start a training process")?;
    anyhow::ensure!(status.success(), "the training process ended with {status}");
    Ok(())
}

/// A temporary folder that is removed with this value.
struct Scratch(PathBuf);

impl Scratch {
    fn make() -> anyhow::Result<Self> {
        let folder = std::env::temp_dir().join(format!("s2mia-verify-{}", std::process::id()));
        std::fs::create_dir(&folder)
            .with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(Self(folder))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // The system clears its temporary folder if this fails.
        let _removed = std::fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn different_states_are_reported_with_their_trials() {
        let states = |texts: [&str; 3]| texts.map(str::to_owned);
        assert!(check_equal(&states(["a", "a", "a"])).is_ok());
        let message = check_equal(&states(["a", "a", "b"])).unwrap_err().to_string();
        assert!(message.contains("`2 actors, stopped and resumed`"), "{message}");
    }
}
