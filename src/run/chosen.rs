//! Which trained policies a command uses: those of a run's newest checkpoint, or of another one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context as _;
use clap::Args;
use learner::observe::metrics;
use learner::store::checkpoint;
use learner::store::json_lines::JsonLinesReader;
use learner::store::run_folder::{METRICS, RunFolder};

use crate::errors::Usage;
use crate::run::{pretrained, run_path};

/// Trained policies.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct ChosenArguments {
    /// Run folder, one of its checkpoints, or a task with a trained team [default: the newest run in ./runs].
    pub(crate) run: Option<PathBuf>,
    /// Checkpoint of the run: the last one, the one with the best evaluation, or that of an iteration [default: last].
    #[arg(long, value_name = "last | best | ITERATION")]
    pub(crate) checkpoint: Option<Which>,
}

/// One of a run's checkpoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// The newest that is whole.
    Last,
    /// The one with the highest mean return in the run's own evaluations.
    Best,
    /// The one after so many iterations.
    Iteration(u64),
}

impl FromStr for Which {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "last" => Ok(Self::Last),
            "best" => Ok(Self::Best),
            number => {
                number.parse().map(Self::Iteration).map_err(|_| "name last, best or an iteration")
            }
        }
    }
}

impl ChosenArguments {
    /// The path of the run, checkpoint or team.
    pub(crate) fn path(&self) -> anyhow::Result<PathBuf> {
        let run = self.run.clone().map_or_else(run_path::newest_run, Ok)?;
        match self.checkpoint {
            None => Ok(run),
            Some(which) => of_run(&run, which),
        }
    }
}

/// A checkpoint of the run at `run`.
fn of_run(run: &Path, which: Which) -> anyhow::Result<PathBuf> {
    let shown = run.display();
    let leave_out = |what| Usage::new(format!("{shown} is {what}; leave out --checkpoint"));
    if pretrained::named(run)?.is_some() {
        return Err(leave_out("a trained team, which has no checkpoints").into());
    }
    if checkpoint::is_checkpoint(run) {
        return Err(leave_out("a checkpoint itself").into());
    }
    run_path::demand_run(run)?;
    let all = checkpoint::all(run)?;
    if all.is_empty() {
        return Err(Usage::new(format!("{shown} has no checkpoint yet")).into());
    }
    match which {
        Which::Last => Ok(run.to_path_buf()),
        Which::Best => checkpoint::best(run, &returns(run)?)?.ok_or_else(|| {
            let why = "has no checkpoint whose policies are evaluated; name an iteration, or last";
            Usage::new(format!("{shown} {why}")).into()
        }),
        Which::Iteration(iteration) => {
            let place = checkpoint::place(run, iteration);
            let known = all.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
            let why =
                format!("{shown} has no checkpoint of iteration {iteration}, only of {known}");
            if all.contains(&iteration) { Ok(place) } else { Err(Usage::new(why).into()) }
        }
    }
}

/// Mean returns of a run's evaluations.
fn returns(run: &Path) -> anyhow::Result<BTreeMap<u64, f64>> {
    let file = RunFolder::of(run).join(METRICS);
    let lines = JsonLinesReader::of(file.clone()).more();
    let lines = lines.with_context(|| format!("cannot read {}", file.display()))?.lines;
    Ok(metrics::returns(&lines))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_is_the_last_the_best_or_that_of_an_iteration() {
        assert_eq!("last".parse(), Ok(Which::Last));
        assert_eq!("best".parse(), Ok(Which::Best));
        assert_eq!("120".parse(), Ok(Which::Iteration(120)));
        assert!("-1".parse::<Which>().is_err() && "newest".parse::<Which>().is_err());
    }
}
