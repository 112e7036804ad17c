//! What people ask of a learner at work. A pause concerns the slot table alone; the rest waits here until the trainer
//! looks, which it does several times a second while it waits for actors, and after each iteration.

use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::watch;

use crate::checkpoint::Saved;
use crate::exchange::Exchange;

/// What the trainer is asked for.
#[derive(Debug, Default)]
pub(super) struct Orders {
    stop: AtomicBool,
    saves: watch::Sender<Saves>,
}

/// Checkpoints that were asked for; everybody who asks before one begins gets the same.
#[derive(Clone, Debug, Default)]
struct Saves {
    asked: u64,
    /// Those of them that have an answer.
    answered: u64,
    latest: Option<Result<Saved, String>>,
}

/// Why there is no checkpoint.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SaveError {
    /// It could not be written.
    #[error("{0}")]
    Failed(String),
    /// The trainer ended before.
    #[error("the learner ends; its last checkpoint is the newest in the run folder")]
    Ended,
}

impl Exchange {
    // What people ask for.

    /// No more work is handed out until [`Self::resume`]. Leases that go on to their end.
    pub fn pause(&self) -> u64 {
        self.change(|shared| {
            shared.table.pause();
            shared.table.counts().leases as u64
        })
    }

    /// Work is handed out again.
    pub fn resume(&self) {
        self.change(|shared| shared.table.resume());
    }

    /// Ends the run as a signal does.
    pub fn ask_to_stop(&self) {
        self.orders.stop.store(true, Ordering::Relaxed);
    }

    /// A checkpoint of the last finished iteration, as soon as the trainer can write one.
    ///
    /// # Errors
    /// It could not be written, or the trainer has ended.
    pub async fn save(&self) -> Result<Saved, SaveError> {
        let mut answers = self.orders.saves.subscribe();
        let mut own = 0;
        self.orders.saves.send_modify(|saves| {
            saves.asked += 1;
            own = saves.asked;
        });
        let answered = answers.wait_for(|saves| saves.answered >= own).await;
        let latest = answered.map_err(|_| SaveError::Ended)?.latest.clone();
        latest.ok_or(SaveError::Ended)?.map_err(SaveError::Failed)
    }

    // What the trainer looks at.

    /// Whether somebody asked the run to end.
    #[must_use]
    pub fn is_asked_to_stop(&self) -> bool {
        self.orders.stop.load(Ordering::Relaxed)
    }

    /// Answers all who wait for a checkpoint by what `write` makes, if anybody does.
    pub fn answer_saves<E: std::fmt::Display>(&self, write: impl FnOnce() -> Result<Saved, E>) {
        let asked = self.orders.saves.borrow().asked;
        if asked == self.orders.saves.borrow().answered {
            return;
        }
        let made = write().map_err(|error| error.to_string());
        self.orders.saves.send_modify(|saves| {
            (saves.answered, saves.latest) = (asked, Some(made));
        });
    }

    /// The trainer is gone: nobody who asks for a checkpoint from now on gets one.
    pub fn refuse_saves(&self) {
        self.orders.saves.send_modify(|saves| (saves.answered, saves.latest) = (u64::MAX, None));
    }
}
