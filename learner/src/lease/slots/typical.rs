//! How long slots usually take, for the decision that one takes too long. Slots of different iterations may differ in size, so
//! times are kept for each environment of a slot.

use std::collections::VecDeque;
use std::time::Duration;

/// Latest slots of which the median is taken.
const LATEST: usize = 16;
/// A slot that takes this many times as long as usual may get a backup lease...
const BACKUP_AFTER: u32 = 3;
/// ... but never before this time: a busy machine alone is no reason to compute a short slot twice.
const SHORTEST: Duration = Duration::from_secs(1);

/// Times of the latest complete slots, for each of their environments.
#[derive(Debug, Default)]
pub(super) struct TypicalTime(VecDeque<Duration>);

impl TypicalTime {
    /// A slot of so many environments was complete this long after its lease.
    pub(super) fn add(&mut self, time: Duration, environments: usize) {
        if self.0.len() == LATEST {
            self.0.pop_front();
        }
        self.0.push_back(time / count(environments));
    }

    /// The age at which a slot of so many environments may get a backup lease; `None` before the first complete slot.
    pub(super) fn backup_age(&self, environments: usize) -> Option<Duration> {
        self.median(environments).map(|median| (median * BACKUP_AFTER).max(SHORTEST))
    }

    /// The median of the latest times, for a slot of so many environments; `None` before the first complete slot.
    pub(super) fn median(&self, environments: usize) -> Option<Duration> {
        let mut times = self.0.iter().copied().collect::<Vec<_>>();
        times.sort_unstable();
        times.get(times.len() / 2).map(|time| *time * count(environments))
    }
}

/// At least 1, so that a slot without environments has a time.
fn count(environments: usize) -> u32 {
    u32::try_from(environments).unwrap_or(u32::MAX).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_with_more_environments_may_take_longer() {
        let mut typical = TypicalTime::default();
        typical.add(Duration::from_secs(4), 2);
        assert_eq!(typical.median(2), Some(Duration::from_secs(4)));
        assert_eq!(typical.median(10), Some(Duration::from_secs(20)));
        assert_eq!(typical.backup_age(1), Some(Duration::from_secs(6)));
    }
}
