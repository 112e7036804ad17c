//! What people ask of a learner at work. A pause concerns the slot table alone; the rest waits here until the trainer
//! looks, which it does several times a second while it waits for actors, and after each iteration.

use std::fmt::Display;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::watch;

use crate::checkpoint::Saved;
use crate::exchange::Exchange;

/// What the trainer is asked for.
#[derive(Debug, Default)]
pub struct Orders {
    stop: AtomicBool,
    saves: watch::Sender<Saves>,
}

/// Checkpoints that were asked for; everybody who asks before one begins gets the same.
#[derive(Debug, Default)]
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

impl Orders {
    /// Ends the run as a signal does.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Whether somebody asked the run to end.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// A checkpoint of the last finished iteration, as soon as the trainer can write one.
    ///
    /// # Errors
    /// It could not be written, or the trainer has ended.
    pub async fn save(&self) -> Result<Saved, SaveError> {
        let mut answers = self.saves.subscribe();
        let mut own = 0;
        self.saves.send_modify(|saves| {
            saves.asked += 1;
            own = saves.asked;
        });
        let answered = answers.wait_for(|saves| saves.answered >= own).await;
        let latest = answered.map_err(|_| SaveError::Ended)?.latest.clone();
        latest.ok_or(SaveError::Ended)?.map_err(SaveError::Failed)
    }

    /// Answers all who wait for a checkpoint by what `write` makes, if anybody does, and says whether anybody did.
    pub fn answer_saves<E: Display>(&self, write: impl FnOnce() -> Result<Saved, E>) -> bool {
        let asked = self.saves.borrow().asked;
        if self.saves.borrow().answered == asked {
            return false;
        }
        let made = write().map_err(|error| error.to_string());
        self.saves.send_modify(|saves| (saves.answered, saves.latest) = (asked, Some(made)));
        true
    }

    /// The trainer is gone: whoever waits for a checkpoint, or asks from now on, gets none.
    pub fn end(&self) {
        self.saves.send_modify(|saves| (saves.answered, saves.latest) = (u64::MAX, None));
    }
}

impl Exchange {
    /// No more work is handed out until [`Self::resume`]; how many leases go on to their end.
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

    /// What the trainer is asked for.
    #[must_use]
    pub fn orders(&self) -> &Orders {
        &self.orders
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    fn saved(iteration: u64) -> Saved {
        let (weights_sha256, state_sha256) = (String::new(), String::new());
        Saved { path: "runs/a".into(), iteration, weights_sha256, state_sha256 }
    }

    #[tokio::test]
    async fn all_who_ask_before_a_checkpoint_begins_get_it_and_later_ones_the_next() {
        let orders = Orders::default();
        assert!(
            !orders.answer_saves(|| -> Result<Saved, Infallible> { panic!("nobody has asked") })
        );
        let answer = async |iteration| {
            tokio::task::yield_now().await;
            assert!(orders.answer_saves(|| Ok::<_, Infallible>(saved(iteration))));
        };
        let (one, other, ()) = tokio::join!(orders.save(), orders.save(), answer(3));
        assert_eq!((one, other), (Ok(saved(3)), Ok(saved(3))));
        let (later, ()) = tokio::join!(orders.save(), answer(4));
        assert_eq!(later, Ok(saved(4)));
    }

    #[tokio::test]
    async fn a_checkpoint_that_failed_is_told_and_the_end_leaves_nobody_waiting() {
        let orders = Orders::default();
        let failure = async { orders.answer_saves(|| Err("the disk is full")) };
        let (told, asked) = tokio::join!(orders.save(), failure);
        assert!(asked);
        assert_eq!(told, Err(SaveError::Failed("the disk is full".to_owned())));
        let (waiting, ()) = tokio::join!(orders.save(), async { orders.end() });
        assert_eq!((waiting, orders.save().await), (Err(SaveError::Ended), Err(SaveError::Ended)));
    }
}
