//! `s2mia experiment`: runs all trainings that a file describes and reports their results.

use learner::run_folder::RunFolder;
use tokio::sync::watch;

use crate::cli::ExperimentArguments;
use crate::errors::Usage;
use crate::experiment::file::ExperimentFile;
use crate::experiment::listing::listing;
use crate::experiment::plan::{PlannedRun, plan, remarks};
use crate::experiment::progress::Progress;
use crate::experiment::record::Record;
use crate::experiment::report;
use crate::experiment::scheduler::{self, Tally};
use crate::process::{output, runtime, signals};

/// Runs what is missing and reports. The status is 0 after a stop, which leaves checkpoints, and 1 if a run failed or
/// could not start.
pub(super) fn run(arguments: &ExperimentArguments) -> anyhow::Result<()> {
    let file = ExperimentFile::read(&arguments.file)?;
    let runs = plan(&file)?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let at_once = arguments.jobs.map_or_else(|| file.runs_at_once(cores), usize::from);
    remarks(&runs).iter().for_each(output::line);
    if arguments.list {
        output::line(listing(&runs, &Record::read(&file.record)?, at_once));
        return Ok(());
    }
    if arguments.report {
        demand_any(&file, &runs)?;
        return tell(&file, &runs);
    }
    learner::durable::make_folder(&file.folder)?;
    let record = Record::read(&file.record)?;
    let (recorded, missing): (Vec<_>, Vec<_>) =
        runs.iter().cloned().partition(|run| record.holds(run));
    let (mut tally, stopped) = runtime()?.block_on(bring_to_end(&missing, at_once))?;
    tally.finished += recorded.len();
    tell(&file, &runs)?;
    finish(&tally, runs.len(), stopped.then_some(arguments))
}

async fn bring_to_end(runs: &[PlannedRun], at_once: usize) -> anyhow::Result<(Tally, bool)> {
    let (stop_sender, stop) = watch::channel(false);
    signals::stop_on_signal(stop_sender, || {
        output::line("stopping after a checkpoint of each run; Ctrl-C again ends at once");
    })?;
    let mut progress = Progress::new(runs);
    let tally = scheduler::run_all(runs, at_once, stop.clone(), &mut progress).await?;
    let stopped = *stop.borrow();
    Ok((tally, stopped))
}

/// Refuses a report of nothing.
fn demand_any(file: &ExperimentFile, runs: &[PlannedRun]) -> anyhow::Result<()> {
    let record = Record::read(&file.record)?;
    if runs.iter().any(|run| record.holds(run) || RunFolder::holds_run(&run.folder)) {
        return Ok(());
    }
    let path = file.path.display();
    let why = format!("no run of {path} has started; `s2mia experiment {path}` starts them");
    Err(Usage::new(why).into())
}

fn tell(file: &ExperimentFile, runs: &[PlannedRun]) -> anyhow::Result<()> {
    let (table, written) = report::write(file, runs)?;
    output::line(table);
    written.iter().for_each(|path| output::line(path.display()));
    Ok(())
}

fn finish(
    tally: &Tally,
    planned: usize,
    stopped: Option<&ExperimentArguments>,
) -> anyhow::Result<()> {
    let Tally { finished, failed, misplaced } = tally;
    if let Some(arguments) = stopped {
        let file = arguments.file.display();
        output::line(format!(
            "stopped with {finished} of {planned} runs finished; resume with `s2mia experiment {file}`"
        ));
    }
    let refused = format!(
        "the folders of {misplaced} of {planned} runs hold other runs; \
         remove those, or give the experiment another `folder`"
    );
    let tried = format!("{failed} of {planned} runs failed; the same command retries them");
    match (failed, misplaced) {
        (0, 0) => Ok(()),
        (_, 0) => anyhow::bail!(tried),
        (0, _) => anyhow::bail!(refused),
        (_, _) => anyhow::bail!("{tried}; {refused}"),
    }
}
