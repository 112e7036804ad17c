//! Checkpoints of the trainer: their content and when they are written.

use std::io;
use std::path::Path;
use std::time::Instant;

use marl::StoredState as _;
use policy::arrays::{Array, NamedArrays};

use crate::error::LearnerError;
use crate::lease::exchange::Storage;
use crate::observe::event::{Event, Stage, WrittenCheckpoint};
use crate::store::checkpoint::{self, Checkpoint, Keep, RunSettings, Saved, Step};
use crate::train::fail_points;
use crate::train::trainer::{RunningTrainer, Trainer};

impl RunningTrainer {
    /// Writes a checkpoint every `checkpoint.every` iterations. A failed one is logged as an error and retried after
    /// the next iteration, and once more after the last one. Meanwhile training continues and the service reports
    /// [`Storage::Degraded`].
    ///
    /// # Errors
    /// The run folder is lost.
    pub(super) fn save_if_due(&mut self) -> Result<(), LearnerError> {
        let trainer = &self.trainer;
        let due = trainer.iteration.is_multiple_of(trainer.launch.config.checkpoint.every);
        if !due && trainer.failed_saves == 0 {
            return Ok(());
        }
        match self.save_now() {
            Ok(_) => self.trainer.failed_saves = 0,
            Err(error) => {
                self.trainer.folder.demand_in_place()?;
                self.trainer.failed_saves += 1;
                let failures = self.trainer.failed_saves;
                let then = if self.trainer.iteration < self.trainer.launch.until {
                    "training continues; retrying after the next iteration"
                } else {
                    "training is over; retrying once"
                };
                tracing::error!(failures, "checkpoint failed: {error}; {then}");
                self.emit(&Event::CheckpointFailed { failures });
                self.outside.exchange.report_storage(Storage::Degraded);
            }
        }
        Ok(())
    }

    /// Writes a checkpoint of the last finished iteration, unless it already exists.
    pub(super) fn save_now(&mut self) -> Result<Saved, LearnerError> {
        let iteration = self.trainer.iteration;
        self.trainer.folder.demand_in_place()?;
        let is_current = |saved: &&Saved| saved.iteration == iteration && saved.path.is_dir();
        if let Some(saved) = self.trainer.saved.as_ref().filter(is_current) {
            return Ok(saved.clone());
        }
        self.emit(&Event::Stage(Stage::Save));
        let begin = Instant::now();
        let storage = self.trainer.flush();
        let saved = self.trainer.save()?;
        self.outside.exchange.report_storage(storage);
        self.trainer.saved = Some(saved.clone());
        self.emit(&Event::Checkpoint(WrittenCheckpoint {
            iteration,
            secs: begin.elapsed().as_secs_f64(),
            bytes: checkpoint::size(&saved.path),
        }));
        Ok(saved)
    }
}

impl Trainer {
    /// Waits until the disk has all lines of metrics and provenance. A checkpoint is worth more than lines that cannot be
    /// written, of which a resume warns.
    fn flush(&mut self) -> Storage {
        let mut storage = Storage::Sound;
        for flushed in [self.metrics.sync(), self.provenance.sync()] {
            if let Err(error) = flushed {
                tracing::error!("{error}; the checkpoint is written without these lines");
                storage = Storage::Degraded;
            }
        }
        storage
    }

    /// Writes a checkpoint.
    fn save(&mut self) -> Result<Saved, LearnerError> {
        let checkpoint = Checkpoint {
            iteration: self.iteration,
            env_steps: self.env_steps(),
            arrays: self.arrays()?,
            policy: self.policy.to_vec(),
        };
        let folder = self.folder.path();
        let newest = self.launch.config.checkpoint.keep_last;
        let outstanding = self.evaluations.outstanding().map(|evaluated| evaluated.iteration);
        let returns = self.evaluations.returns();
        let keep = Keep { newest, returns: &returns, outstanding };
        let sha256 = self.launch.config_sha256.to_string();
        let settings = RunSettings { sha256: &sha256, toml: &self.launch.config_toml };
        let mut before = |step, _: &Path| {
            if step == Step::Rename {
                fail_points::abort_at("mid-checkpoint", self.iteration);
            }
            self.folder.demand_in_place().map_err(io::Error::other)?;
            fail_points::fail_at(step, self.iteration)
        };
        Ok(checkpoint::save(folder, &checkpoint, settings, &keep, &mut before)?)
    }

    /// The state that the next iteration depends on, and the latest evaluation.
    fn arrays(&mut self) -> Result<NamedArrays, LearnerError> {
        let mut arrays = self.algorithm.arrays()?;
        arrays.extend(self.surprise.arrays()?);
        arrays.extend(self.observations.arrays()?);
        arrays.extend(self.environments.arrays());
        arrays.extend(self.evaluations.arrays());
        for (name, count) in [("iteration", self.iteration), ("env_steps", self.env_steps())] {
            let array = Array::I64 { shape: vec![1], data: vec![count as i64] };
            arrays.insert(format!("counters/{name}"), array);
        }
        Ok(arrays)
    }

    /// Restores the state of a checkpoint.
    pub(crate) fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), LearnerError> {
        let arrays = &checkpoint.arrays;
        self.iteration = checkpoint::fields::one_count(arrays, "counters/iteration")?;
        self.algorithm.restore(arrays)?;
        self.surprise.restore(arrays)?;
        self.observations.restore(arrays)?;
        self.environments.restore(arrays, self.iteration)?;
        self.evaluations.restore(arrays)?;
        self.encode_policies(self.iteration)?;
        Ok(())
    }
}
