//! The arguments of `s2mia experiment`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::errors::Usage;
use crate::experiment::selection::{Selection, Shard};
use crate::experiment::submit::Jobs;
use crate::experiment::submit::slurm::Options;

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
    pub(crate) fn slurm(&self) -> Result<Options<'_>, Usage> {
        let others = [("--image", self.image.is_some()), ("--queue", self.queue.is_some())];
        refuse(&others, "k8s")?;
        Ok(Options { partition: self.partition.as_deref(), time: self.time.as_deref() })
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
