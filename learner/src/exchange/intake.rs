//! What actors send, counted.

use crate::exchange::Exchange;

impl Exchange {
    /// A message with results came in, fit or not.
    pub fn count_bytes(&self, bytes: usize) {
        self.lock().bytes_taken_in += bytes as u64;
    }

    /// A log lost `steps`, an actor's or the learner's own. An actor may claim any number, which stops at the highest
    /// there is.
    pub fn count_lost_log_steps(&self, steps: u64) {
        let mut shared = self.lock();
        shared.log_steps_lost = shared.log_steps_lost.saturating_add(steps);
    }
}
