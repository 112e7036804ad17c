//! Builds a trainer from the settings of a run: a new one, or one that resumes from the newest valid checkpoint.

use std::path::PathBuf;

use bytes::Bytes;
use marl::Surprise;
use proto::{Incarnation, RunDescription};
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::LearnerError;
use crate::launch::Launch;
use crate::lease::sample::random_number;
use crate::observe::metrics::Metrics;
use crate::store::checkpoint::{self, CheckpointError, Loaded};
use crate::store::durable;
use crate::store::run_folder::{RunFolder, RunFolderError, START_POLICIES};
use crate::train::assemble::problem;
use crate::train::environments::Environments;
use crate::train::evaluation::Evaluations;
use crate::train::provenance::Provenance;
use crate::train::trainer::Trainer;

/// Claims the run folder and builds the trainer; nothing is overwritten unless everything fits.
///
/// # Errors
/// Names a folder that is taken, in use or of another run, and a checkpoint that does not fit.
pub fn prepare(launch: Launch) -> Result<(Trainer, RunDescription), LearnerError> {
    launch.validate()?;
    let folder = claim(&launch)?;
    let resumed = newest(&launch, &folder)?;
    let iteration = resumed.as_ref().map_or(0, |loaded| loaded.checkpoint.iteration);
    if iteration > launch.iterations {
        let path = resumed.map_or_else(PathBuf::new, |loaded| loaded.path);
        return Err(LearnerError::Other(format!(
            "{} stands at iteration {iteration}, past the {} that this run should have",
            path.display(),
            launch.iterations
        )));
    }
    if let Some(policies) = &launch.start {
        durable::replace(&folder.file(START_POLICIES), policies)?;
    }
    folder.begin(&launch.config_toml, &launch.manifest())?;
    let description = launch.description(Incarnation(random_number()));
    let mut trainer = build(launch, folder, &description, iteration)?;
    if let Some(loaded) = resumed {
        trainer.restore(&loaded.checkpoint)?;
        trainer.begin_invalid_again(&loaded.path);
        trainer.saved = Some(loaded.saved());
    }
    Ok((trainer, description))
}

fn claim(launch: &Launch) -> Result<RunFolder, RunFolderError> {
    if launch.resume {
        RunFolder::claim_existing(&launch.folder, &launch.config_sha256.to_string())
    } else {
        RunFolder::claim_new(&launch.folder)
    }
}

/// The checkpoint to resume from; `None` for a new run, and for one that ended before its first.
fn newest(launch: &Launch, folder: &RunFolder) -> Result<Option<Loaded>, LearnerError> {
    if !launch.resume {
        return Ok(None);
    }
    let loaded = match checkpoint::load_newest(folder.path()) {
        Err(CheckpointError::None { folder }) => {
            tracing::warn!("{} holds no checkpoint: the run begins again", folder.display());
            return Ok(None);
        }
        loaded => loaded?,
    };
    let newer = loaded.skipped.iter().find(|(path, _)| checkpoint::is_of_newer_program(path));
    if let Some((path, reason)) = newer {
        let why = "use the newer program, or move the checkpoint out of the folder";
        return Err(LearnerError::Other(format!("{}: {reason}; {why}", path.display())));
    }
    for (path, reason) in &loaded.skipped {
        tracing::error!("{} is damaged and skipped: {reason}", path.display());
    }
    let from = loaded.checkpoint.iteration;
    let whole = loaded.skipped.is_empty();
    let latest = checkpoint::named_latest(&checkpoint::folder(folder.path()));
    if let Some(latest) = latest.filter(|at| *at > from && whole) {
        let path = loaded.path.display();
        tracing::error!(
            "the checkpoint of iteration {latest} is lost; the run continues from {path}"
        );
    }
    let (found, expected) = (&loaded.manifest.config_sha256, launch.config_sha256.to_string());
    if *found != expected {
        return Err(LearnerError::Other(format!(
            "{} has other settings than this run: its config is {found}, this run's is {expected}; if another version of the \
             program made it, resume with that version; if it is another run's, move it out of the folder, and the resume \
             continues from an older one, or begins again without any",
            loaded.path.display()
        )));
    }
    Ok(Some(loaded))
}

/// A trainer before the first iteration, whose metrics and provenance reach to `iteration`.
fn build(
    launch: Launch,
    folder: RunFolder,
    description: &RunDescription,
    iteration: u64,
) -> Result<Trainer, LearnerError> {
    let pool = pool(launch.config.learner.threads)?;
    let problem = problem(&launch.environment);
    let (algorithm, observations) = pool.install(|| launch.first_state())?;
    let environments = &launch.config.environments;
    let (metrics, measured) = Metrics::open(folder.path(), iteration)?;
    let mut trainer = Trainer {
        surprise: Surprise::new(&launch.training.surprise, &problem, launch.seed)?,
        environments: Environments::fresh(description, environments.count, environments.phase),
        evaluations: Evaluations::new(
            launch.config.evaluation.clone(),
            environments.steps_per_iteration(),
            launch.iterations,
            measured,
            launch.evaluations.clone(),
        ),
        policy: Bytes::new(),
        observations,
        algorithm,
        iteration: 0,
        provenance: Provenance::open(folder.path(), iteration)?,
        folder,
        metrics,
        saved: None,
        failed_saves: 0,
        pool,
        launch,
    };
    trainer.encode_policies(0)?;
    Ok(trainer)
}

/// Number of threads; 0 means one per core. rayon would read `RAYON_NUM_THREADS` instead.
fn thread_count(threads: usize) -> usize {
    match threads {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        threads => threads,
    }
}

fn pool(threads: usize) -> Result<ThreadPool, LearnerError> {
    let name = |index| format!("update-{index}");
    ThreadPoolBuilder::new().num_threads(thread_count(threads)).thread_name(name).build().map_err(
        |error| LearnerError::Other(format!("cannot start the pool of update threads: {error}")),
    )
}

#[cfg(test)]
mod tests {
    use super::thread_count;

    #[test]
    fn no_number_of_threads_stands_for_one_per_core() {
        let cores = std::thread::available_parallelism().expect("a machine with cores").get();
        assert_eq!((thread_count(0), thread_count(3)), (cores, 3));
    }
}
