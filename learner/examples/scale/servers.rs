//! Queues with servers, such as the cores of a machine or one direction of a network link.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::time::Duration;

/// Equal servers that process jobs in the order of arrival.
pub(crate) struct Servers {
    free_at: BinaryHeap<Reverse<Duration>>,
}

impl Servers {
    /// `count` servers, at least one, without jobs.
    pub(crate) fn new(count: usize) -> Self {
        Self { free_at: vec![Reverse(Duration::ZERO); count].into() }
    }

    /// End of a job of this length that arrives `now`. Calls are in the order of time.
    pub(crate) fn serve(&mut self, now: Duration, length: Duration) -> Duration {
        let Reverse(free) = self.free_at.pop().expect("there is a server");
        let end = free.max(now) + length;
        self.free_at.push(Reverse(end));
        end
    }
}
