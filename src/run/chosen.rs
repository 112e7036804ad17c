//! Which trained policies a command uses: those of a run's newest checkpoint, or of another one.

use std::path::{Path, PathBuf};

use clap::Args;
use learner::observe::metrics;
use learner::store::checkpoint;
use learner::store::run_folder::{METRICS, RunFolder};

use crate::config::keys::URL;
use crate::config::resolved::Resolved;
use crate::config::run_config::RunConfig;
use crate::errors::Usage;
use crate::process::shell;
use crate::run::recorded::all_lines;
use crate::run::stored::{self, Trained};
use crate::run::{pretrained, run_path};

/// Trained policies.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ChosenArguments {
    /// Run folder, one of its checkpoints, or a task with a trained team [default: the newest run in ./runs].
    pub(crate) run: Option<PathBuf>,
    /// Checkpoint: the last one, the one with the best evaluation, that of an iteration, or one by its folder [default: last].
    #[arg(long, value_name = "last | best | ITERATION | FOLDER")]
    pub(crate) checkpoint: Option<Which>,
}

/// Where the program listens that offers the environment of a run.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ProgramArguments {
    /// URL of the external program that offers the run's environment [default: the URL of the run].
    #[arg(long, value_name = "URL")]
    pub(crate) environment: Option<String>,
}

impl ProgramArguments {
    /// Gives the settings of a run this URL; refuses it for a run in the simulator.
    pub(crate) fn replace(&self, resolved: &mut Resolved) -> Result<(), Usage> {
        let Some(url) = &self.environment else { return Ok(()) };
        if resolved.text(URL).is_empty() {
            let why = "--environment: no external program offers the environment of this run; leave it out";
            return Err(Usage::new(why.to_owned()));
        }
        resolved.set(URL, url.as_str(), "--environment");
        Ok(())
    }

    /// The policies of the run at `run`, whose environment is at this URL.
    pub(crate) fn trained(&self, run: &Path) -> anyhow::Result<Trained> {
        let mut trained = stored::trained(run)?;
        if self.environment.is_some() {
            self.replace(&mut trained.config.resolved)?;
            trained.config = RunConfig::build(trained.config.resolved)?;
        }
        Ok(trained)
    }
}

/// One of a run's checkpoints.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// The newest that is whole.
    Last,
    /// The one with the highest mean return in the run's own evaluations.
    Best,
    /// The one after so many iterations.
    Iteration(u64),
    /// The one in this folder.
    Folder(PathBuf),
}

impl From<&str> for Which {
    fn from(text: &str) -> Self {
        match (text, text.parse()) {
            ("last", _) => Self::Last,
            ("best", _) => Self::Best,
            (_, Ok(iteration)) => Self::Iteration(iteration),
            (folder, Err(_)) => Self::Folder(folder.into()),
        }
    }
}

impl ChosenArguments {
    /// The path of the run, checkpoint or team.
    pub(crate) fn path(&self) -> anyhow::Result<PathBuf> {
        if let (None, Some(Which::Folder(folder))) = (&self.run, &self.checkpoint) {
            return in_folder(folder);
        }
        let run = self.run.clone().map_or_else(run_path::newest_run, Ok)?;
        match &self.checkpoint {
            None => Ok(run),
            Some(which) => of_run(&run, which),
        }
    }
}

/// The folder of a checkpoint.
fn in_folder(folder: &Path) -> anyhow::Result<PathBuf> {
    let folder = shell::expanded(folder)?;
    if checkpoint::is_checkpoint(&folder) {
        return Ok(folder);
    }
    let why = "is no checkpoint; name last, best, an iteration or the folder of a checkpoint";
    Err(Usage::new(format!("`{}` {why}", folder.display())).into())
}

/// A checkpoint of the run at `run`.
pub(crate) fn of_run(run: &Path, which: &Which) -> anyhow::Result<PathBuf> {
    let shown = run.display();
    let only =
        |what| Usage::new(format!("{shown} is {what}, which has no checkpoints to choose from"));
    if pretrained::named(run)?.is_some() {
        return Err(only("a trained team").into());
    }
    if checkpoint::is_checkpoint(run) {
        return Err(only("a checkpoint itself").into());
    }
    run_path::demand_run(run)?;
    let all = checkpoint::all(run)?;
    if all.is_empty() {
        return Err(Usage::new(format!("{shown} has no checkpoint yet")).into());
    }
    match which {
        Which::Last => Ok(run.to_path_buf()),
        Which::Folder(folder) => {
            let folder = in_folder(folder)?;
            let own = RunFolder::of(&folder).canonicalize()?;
            let why = format!("{} is no checkpoint of {shown}; name one of them", folder.display());
            if own == run.canonicalize()? { Ok(folder) } else { Err(Usage::new(why).into()) }
        }
        Which::Best => {
            let lines = all_lines(&run.join(METRICS))?;
            let returns = metrics::returns(&metrics::measured(&lines));
            checkpoint::best(run, &returns)?.ok_or_else(|| {
                let why =
                    "has no checkpoint whose policies are evaluated; name an iteration, or last";
                Usage::new(format!("{shown} {why}")).into()
            })
        }
        Which::Iteration(iteration) => {
            let place = checkpoint::place(run, *iteration);
            let known = all.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
            let why =
                format!("{shown} has no checkpoint of iteration {iteration}, only of {known}");
            if all.contains(iteration) { Ok(place) } else { Err(Usage::new(why).into()) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_is_the_last_the_best_that_of_an_iteration_or_that_in_a_folder() {
        for (text, which) in [
            ("last", Which::Last),
            ("best", Which::Best),
            ("120", Which::Iteration(120)),
            ("a/iter_00000120", Which::Folder("a/iter_00000120".into())),
        ] {
            assert_eq!(Which::from(text), which);
        }
    }
}
