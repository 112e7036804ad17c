//! `s2mia train --verify-determinism`: three short runs with different disturbances must end in the same state.

use std::io::{BufRead as _, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use anyhow::Context as _;
use learner::checkpoint;
use security::Token;

use crate::config::environment_section::EnvironmentSection;
use crate::process::output;
use crate::run::launch::SettingsArguments;
use crate::run::run_path;

/// Poll interval for a running learner.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Disturbance of a trial.
#[derive(Clone, Copy)]
enum Disturbance {
    Nothing,
    /// One actor is killed after the first iteration.
    ActorKilled,
    /// The run is stopped after the first iteration and resumed.
    Stopped,
}

/// Name, number of actors and disturbance.
const TRIALS: [(&str, usize, Disturbance); 3] = [
    ("1 actor, undisturbed", 1, Disturbance::Nothing),
    ("2 actors, one killed", 2, Disturbance::ActorKilled),
    ("2 actors, stopped and resumed", 2, Disturbance::Stopped),
];

/// Runs all trials for `iterations` and prints the final state of each.
///
/// # Errors
/// A trial failed, or the states differ.
pub(crate) fn verify(
    settings: &SettingsArguments,
    environment: &EnvironmentSection,
    iterations: u64,
) -> anyhow::Result<()> {
    let place = Scratch::make()?;
    let mut states = Vec::new();
    for (index, (name, actors, disturbance)) in TRIALS.into_iter().enumerate() {
        let folder = place.0.join(index.to_string());
        let trial = Trial { settings, environment, folder: &folder, actors };
        trial.play(disturbance, iterations).with_context(|| format!("trial `{name}` failed"))?;
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
    environment: &'a EnvironmentSection,
    folder: &'a Path,
    actors: usize,
}

impl Trial<'_> {
    fn play(&self, disturbance: Disturbance, iterations: u64) -> anyhow::Result<()> {
        match disturbance {
            Disturbance::Nothing => self.start(iterations)?.end(),
            Disturbance::ActorKilled => {
                let mut processes = self.start(iterations)?;
                processes.wait_for_an_iteration(self.folder)?;
                processes.actors[0].kill().context("cannot kill an actor")?;
                processes.end()
            }
            Disturbance::Stopped => {
                self.start(1)?.end()?;
                self.start(iterations)?.end()
            }
        }
    }

    /// Starts the learner, which resumes the run in the folder if there is one, and the actors.
    fn start(&self, iterations: u64) -> anyhow::Result<TrialProcesses> {
        let program = std::env::current_exe().context("cannot find this program")?;
        let mut command = Command::new(&program);
        command
            .args(["learner", "--listen", "127.0.0.1:0", "--page", "off"])
            .args(self.settings.written());
        for file in &self.settings.files {
            command.arg("--config").arg(file);
        }
        command.arg(format!("run.dir={}", self.folder.display()));
        command.arg(format!("run.iterations={iterations}")).arg("evaluation.every_steps=0");
        if std::env::var_os("RUST_LOG").is_none() {
            // The disturbances are intended; warnings about them would confuse the user.
            command.env("RUST_LOG", "error");
        }
        let token = Token::random()?;
        command.env(Token::VARIABLE, token.text());
        let mut learner = command.stdout(Stdio::piped()).spawn().context("no learner")?;
        let lines = learner.stdout.take().map(BufReader::new).context("no output")?.lines();
        let mut processes = TrialProcesses { learner, lines, actors: Vec::new() };
        let opening = processes.lines.next().context("the learner did not start")??;
        let url = opening.split_whitespace().last().unwrap_or_default();
        for _ in 0..self.actors {
            let mut actor = Command::new(&program);
            actor.args(["actor", "--exit-with-stdin", "--learner", url]);
            actor.args(self.environment.arguments()).env(Token::VARIABLE, token.text());
            actor.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
            processes.actors.push(actor.spawn().context("no actor")?);
        }
        Ok(processes)
    }
}

/// Processes of a learner and its actors; dropping this value ends them.
struct TrialProcesses {
    learner: Child,
    lines: Lines<BufReader<ChildStdout>>,
    actors: Vec<Child>,
}

impl TrialProcesses {
    fn wait_for_an_iteration(&mut self, folder: &Path) -> anyhow::Result<()> {
        let metrics = run_path::metrics_file(folder);
        while !std::fs::metadata(&metrics).is_ok_and(|file| file.len() > 0) {
            if self.learner.try_wait()?.is_some() {
                return Ok(());
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        Ok(())
    }

    fn end(mut self) -> anyhow::Result<()> {
        self.lines.by_ref().for_each(drop);
        let status = self.learner.wait()?;
        anyhow::ensure!(status.success(), "the learner ended with {status}");
        Ok(())
    }
}

impl Drop for TrialProcesses {
    fn drop(&mut self) {
        for process in self.actors.iter_mut().chain([&mut self.learner]) {
            // Fails for a process that has already ended.
            let _ended = process.kill();
            let _reaped = process.wait();
        }
    }
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
