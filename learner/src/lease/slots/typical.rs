//! How long slots usually take, for the decision that one takes too long.

use std::collections::VecDeque;
use std::time::Duration;

/// Latest slots of which the median is taken.
const LATEST: usize = 16;
/// A slot that takes this many times as long as usual may get a backup lease...
const BACKUP_AFTER: u32 = 3;
/// ... but never before this time: a busy machine alone is no reason to compute a short slot twice.
const SHORTEST: Duration = Duration::from_secs(1);

/// Times of the latest complete slots.
#[derive(Debug, Default)]
pub(super) struct TypicalTime(VecDeque<Duration>);

impl TypicalTime {
    /// A slot was complete this long after its lease.
    pub(super) fn add(&mut self, time: Duration) {
        if self.0.len() == LATEST {
            self.0.pop_front();
        }
        self.0.push_back(time);
    }

    /// The age at which a slot may get a backup lease; `None` before the first complete slot.
    pub(super) fn backup_age(&self) -> Option<Duration> {
        self.median().map(|median| (median * BACKUP_AFTER).max(SHORTEST))
    }

    /// The median of the latest times; `None` before the first complete slot.
    pub(super) fn median(&self) -> Option<Duration> {
        let mut times = self.0.iter().copied().collect::<Vec<_>>();
        times.sort_unstable();
        times.get(times.len() / 2).copied()
    }
}
