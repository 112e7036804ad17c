//! `s2mia experiment`: runs all trainings that a file describes and reports their results.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use learner::store::run_folder::RunFolder;
use tokio::sync::watch;

use crate::errors::Usage;
use crate::experiment::file::ExperimentFile;
use crate::experiment::record::{self, Record};
use crate::experiment::run_state::{is_finished, listing, mismatch};
use crate::experiment::scheduler::{ExperimentProgress, Tally};
use crate::experiment::submit::{self, Jobs, SlurmOptions};
use crate::experiment::{
    PlannedRun, Selection, Shard, plan, remarks, report, run_state, scheduler,
};
use crate::figures::chart;
use crate::process::{self, output, runtime, shell, target};
use crate::run::run_path::Others;

/// `s2mia experiment`
#[derive(Args, Debug)]
pub(crate) struct ExperimentArguments {
    /// TOML file with tasks, variants and seeds.
    pub(crate) file: PathBuf,
    /// Only list the runs: index, length and progress.
    #[arg(long, visible_alias = "status", conflicts_with = "report")]
    pub(crate) list: bool,
    /// Only make tables and figures from the existing runs.
    #[arg(long)]
    pub(crate) report: bool,
    /// Use the experiment's folder although it has files of others and no run.
    #[arg(long)]
    pub(crate) force: bool,
    /// Number of parallel runs [default: from the number of cores].
    #[arg(long, value_name = "RUNS", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) jobs: Option<u16>,
    /// Only the runs whose index modulo N is I.
    #[arg(long, value_name = "I/N", conflicts_with_all = ["only", "report"])]
    shard: Option<Shard>,
    /// Only the run with this index.
    #[arg(long, value_name = "INDEX", conflicts_with = "report")]
    only: Option<usize>,
    /// Compute the runs on a cluster: submit a Slurm job array, or print a Kubernetes Job for `kubectl apply -f -`.
    #[arg(long, value_enum, value_name = "ENGINE")]
    #[arg(conflicts_with_all = ["list", "report", "jobs", "shard", "only"])]
    pub(crate) submit: Option<Engine>,
    /// Jobs of a cluster.
    #[command(flatten)]
    pub(crate) cluster: ClusterArguments,
}

/// What schedules the jobs of a cluster.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Engine {
    /// A job array of Slurm.
    Slurm,
    /// An Indexed Job of Kubernetes.
    K8s,
}

/// Options of `--submit`.
#[derive(Args, Debug)]
#[group(skip)]
pub(crate) struct ClusterArguments {
    /// With --submit: runs that one job computes one after the other.
    #[arg(long, value_name = "RUNS", requires = "submit", default_value_t = 1)]
    #[arg(value_parser = clap::value_parser!(u16).range(1..))]
    runs_per_job: u16,
    /// With --submit: greatest number of jobs at the same time [default: no limit].
    #[arg(long, value_name = "JOBS", requires = "submit")]
    #[arg(value_parser = clap::value_parser!(u16).range(1..))]
    array_limit: Option<u16>,
    /// With --submit slurm: print the script and do nothing else.
    #[arg(long, requires = "submit")]
    pub(crate) dry_run: bool,
    /// With --submit slurm: partition [default: the cluster's].
    #[arg(long, value_name = "PARTITION", requires = "submit")]
    partition: Option<String>,
    /// With --submit slurm: time limit of a job, such as 4:00:00; a job that reaches it is resumed [default: the partition's].
    #[arg(long, value_name = "TIME", requires = "submit")]
    time: Option<String>,
    /// With --submit k8s: container image [default: s2mia].
    #[arg(long, value_name = "IMAGE", requires = "submit")]
    image: Option<String>,
    /// With --submit k8s: local queue of Kueue.
    #[arg(long, value_name = "NAME", requires = "submit")]
    queue: Option<String>,
}

impl ClusterArguments {
    /// The jobs for this number of runs.
    pub(crate) fn jobs(&self, runs: usize) -> Jobs {
        let limit = self.array_limit.map(usize::from);
        Jobs { runs, runs_per_job: self.runs_per_job.into(), limit }
    }

    /// Options of Slurm.
    pub(crate) fn slurm(&self) -> Result<SlurmOptions<'_>, Usage> {
        let others = [("--image", self.image.is_some()), ("--queue", self.queue.is_some())];
        refuse(&others, "k8s")?;
        Ok(SlurmOptions { partition: self.partition.as_deref(), time: self.time.as_deref() })
    }

    /// Image and queue of Kubernetes.
    pub(crate) fn k8s(&self) -> Result<(&str, Option<&str>), Usage> {
        let (partition, time) = (self.partition.is_some(), self.time.is_some());
        let others = [("--partition", partition), ("--time", time), ("--dry-run", self.dry_run)];
        refuse(&others, "slurm")?;
        Ok((self.image.as_deref().unwrap_or("s2mia"), self.queue.as_deref()))
    }
}

/// Refuses options of another engine.
fn refuse(given: &[(&str, bool)], engine: &str) -> Result<(), Usage> {
    match given.iter().find(|(_, given)| *given) {
        Some((option, _)) => {
            Err(Usage::new(format!("{option} is an option of --submit {engine}; leave it out")))
        }
        None => Ok(()),
    }
}

impl ExperimentArguments {
    /// The runs that this process computes or lists.
    pub(crate) fn selection(&self) -> Selection {
        match (self.shard, self.only) {
            (Some(shard), _) => Selection::Shard(shard),
            (None, Some(index)) => Selection::Only(index),
            (None, None) => Selection::All,
        }
    }
}

/// Signals within this time are one stop request: Slurm signals all processes of a job, and the job's script passes the
/// signal on.
const SIGNAL_WINDOW: Duration = Duration::from_secs(2);

/// Runs what is missing and reports. The status is 0 after a stop, which leaves checkpoints, and 1 if a run failed, could not start,
/// is damaged, or was stopped alone.
pub(super) fn run(arguments: &ExperimentArguments) -> anyhow::Result<()> {
    if arguments.file.to_str().is_none() {
        return Err(Usage::new(shell::not_text(&[arguments.file.clone().into()])).into());
    }
    let file = ExperimentFile::read(&arguments.file)?;
    let runs = plan(&file)?;
    let selected = arguments.selection().of(&runs)?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let at_once = arguments.jobs.map_or_else(|| file.runs_at_once(cores), usize::from);
    run_state::demand_own_record(&file, &runs)?;
    if let Some(engine) = arguments.submit {
        return submit(&file, &runs, engine, arguments);
    }
    remarks(&runs).iter().for_each(output::line);
    let record = Record::read(&file.record)?;
    if arguments.list {
        output::line(listing(&selected, &record, at_once));
        return Ok(());
    }
    if arguments.report {
        demand_any(&file, &runs, &record)?;
        return report(&file, &runs);
    }
    record.demand_new(&file.record, &selected)?;
    run_state::make_folder(&file, &runs, others(arguments))?;
    if !file.record.as_os_str().is_empty() {
        record::place(&file.record)?.demand_writable()?;
    }
    let (recorded, missing): (Vec<_>, Vec<_>) =
        selected.iter().cloned().partition(|run| record.holds(run));
    // Lives until the report is written, so that a second signal ends the process then, too.
    let runtime = runtime()?;
    let (mut tally, stopped) = runtime.block_on(bring_to_end(&missing, at_once))?;
    tally.finished += recorded.len();
    let is_done = |run: &PlannedRun| record.holds(run) || is_finished(run);
    let reported = if arguments.selection() == Selection::All || runs.iter().all(is_done) {
        report(&file, &runs)
    } else {
        output::line(rest(&tally, selected.len(), arguments));
        Ok(())
    };
    match (reported, finish(&tally, selected.len(), stopped.then_some(arguments))) {
        (reported, Ok(())) => reported,
        (Ok(()), failed) => failed,
        (Err(why), failed) => {
            tracing::warn!("{why:#}");
            failed
        }
    }
}

/// Writes and submits the script of Slurm's jobs, or prints what Kubernetes needs.
fn submit(
    file: &ExperimentFile,
    runs: &[PlannedRun],
    engine: Engine,
    arguments: &ExperimentArguments,
) -> anyhow::Result<()> {
    let cluster = &arguments.cluster;
    let jobs = cluster.jobs(runs.len());
    match engine {
        Engine::K8s => {
            let (image, queue) = cluster.k8s()?;
            output::line(submit::k8s_manifest((file, runs), &jobs, image, queue)?.trim_end());
        }
        Engine::Slurm if cluster.dry_run => {
            output::line(submit::slurm_script(file, &jobs, cluster.slurm()?)?.trim_end());
        }
        Engine::Slurm => {
            let script = submit::slurm_script(file, &jobs, cluster.slurm()?)?;
            submit::demand_sbatch()?;
            Record::read(&file.record)?.demand_new(&file.record, runs)?;
            run_state::make_folder(file, runs, others(arguments))?;
            let path = file.folder.join(submit::SLURM_SCRIPT_NAME);
            target::file(&path, script.as_bytes())?;
            output::line(submit::submit_to_slurm(&path)?);
        }
    }
    Ok(())
}

/// What the experiment's folder may contain before the first run.
fn others(arguments: &ExperimentArguments) -> Others {
    if arguments.force { Others::Accepted } else { Others::Refused }
}

async fn bring_to_end(runs: &[PlannedRun], at_once: usize) -> anyhow::Result<(Tally, bool)> {
    let (stop_sender, stop) = watch::channel(false);
    let announce = || {
        output::line(
            "stopping after a checkpoint of each run; Ctrl-C again, two seconds later, ends at once",
        );
    };
    process::stop_or_exit(stop_sender, SIGNAL_WINDOW, announce, || ())?;
    let mut progress = ExperimentProgress::new(runs);
    let tally = scheduler::run_all(runs, at_once, stop.clone(), &mut progress).await?;
    let stopped = *stop.borrow();
    Ok((tally, stopped))
}

/// Refuses a report of nothing. Prints which folders it leaves out, because they hold runs with other settings.
fn demand_any(file: &ExperimentFile, runs: &[PlannedRun], record: &Record) -> Result<(), Usage> {
    let begun = |run: &&PlannedRun| !record.holds(run) && RunFolder::holds_run(&run.folder);
    let left_out: Vec<String> = runs.iter().filter(begun).filter_map(mismatch).collect();
    let reported = runs.iter().filter(|run| record.holds(run) || begun(run)).count();
    match (reported - left_out.len(), left_out.first()) {
        (0, None) => record.demand_new(&file.record, runs)?,
        (0, Some(why)) => return Err(Usage::new(why)),
        _ => {
            left_out.iter().for_each(output::line);
            return Ok(());
        }
    }
    let path = shell::path(&file.path);
    let shown = file.path.display();
    let why = format!("no run of {shown} has started; `s2mia experiment {path}` starts them");
    Err(Usage::new(why))
}

/// Result of a part of an experiment whose other runs are not finished.
fn rest(tally: &Tally, planned: usize, arguments: &ExperimentArguments) -> String {
    let finished = tally.finished;
    let file = shell::path(&arguments.file);
    format!(
        "{finished} of {planned} selected runs are finished; when all runs are, `s2mia experiment {file} --report` \
         compares them"
    )
}

/// Writes and prints the report. Runs that it leaves out because their folders are damaged are named, the first in the error.
fn report(file: &ExperimentFile, runs: &[PlannedRun]) -> anyhow::Result<()> {
    let report = report::write(file, runs)?;
    output::line(report.table);
    report.written.iter().for_each(|path| output::line(path.display()));
    let Some((first, others)) = report.damaged.split_first() else { return Ok(()) };
    others.iter().for_each(|why| tracing::warn!("{why}"));
    match others.len() {
        0 => anyhow::bail!("{first}"),
        others => anyhow::bail!("{first} ({}, too)", chart::count_of(others as u64, "other run")),
    }
}

fn finish(
    tally: &Tally,
    planned: usize,
    stopped: Option<&ExperimentArguments>,
) -> anyhow::Result<()> {
    let Tally { finished, failed, misplaced, stopped: ended } = tally;
    if let Some(arguments) = stopped {
        let file = shell::path(&arguments.file);
        let selection = arguments.selection();
        output::line(format!(
            "stopped with {finished} of {planned} runs finished; resume with `s2mia experiment {file}{selection}`"
        ));
    }
    let refused = format!(
        "the folders of {misplaced} of {planned} runs hold runs with other settings; \
         restore the settings, or give the experiment another `folder`"
    );
    let tried = format!("{failed} of {planned} runs failed; the same command retries them");
    match (failed, misplaced) {
        (0, 0) if *ended > 0 && stopped.is_none() => {
            anyhow::bail!("{ended} of {planned} runs were stopped; the same command resumes them")
        }
        (0, 0) => Ok(()),
        (_, 0) => anyhow::bail!(tried),
        (0, _) => anyhow::bail!(refused),
        (_, _) => anyhow::bail!("{tried}; {refused}"),
    }
}
