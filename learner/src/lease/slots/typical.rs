//! How long slots and episodes usually take, for the decision that one takes too long. Messages and round trips make the
//! time for each environment depend on the size of a slot, so only slots of the latest size count.

use std::collections::VecDeque;
use std::time::Duration;

use proto::Work;

use super::works::{Group, Works, environments};

/// Latest slots of which the median is taken.
const LATEST: usize = 16;
/// A slot that takes this many times as long as usual may get a backup lease...
const BACKUP_AFTER: u32 = 3;
/// ... but never before this time: a busy machine alone is no reason to compute a short slot twice.
const SHORTEST: Duration = Duration::from_secs(1);

/// Times of the latest complete slots and episodes.
#[derive(Debug)]
pub(super) struct TypicalTimes {
    /// A lease's time to live.
    ttl: Duration,
    pub(super) slots: TypicalTime,
    episodes: TypicalTime,
}

impl TypicalTimes {
    pub(super) fn new(ttl: Duration) -> Self {
        Self { ttl, slots: TypicalTime::default(), episodes: TypicalTime::default() }
    }

    /// Work of this group was complete this long after its lease.
    pub(super) fn add(&mut self, group: Group, time: Duration, work: &Work) {
        let latest = match group {
            Group::Slots => &mut self.slots,
            Group::Evaluation(_) => &mut self.episodes,
        };
        latest.add(time, environments(work));
    }

    /// The age at which the work of a group may get a backup lease: a time to live before the first complete
    /// one of its size.
    pub(super) fn backup_age(&self, works: &Works) -> Duration {
        let latest = match works.group {
            Group::Slots => &self.slots,
            Group::Evaluation(_) => &self.episodes,
        };
        latest.backup_age(works.item_environments).unwrap_or(self.ttl)
    }
}

#[derive(Debug, Default)]
pub(super) struct TypicalTime {
    /// Environments of each of these slots.
    environments: usize,
    times: VecDeque<Duration>,
}

impl TypicalTime {
    /// A slot of so many environments was complete this long after its lease.
    fn add(&mut self, time: Duration, environments: usize) {
        if environments != self.environments {
            *self = Self { environments, times: VecDeque::new() };
        }
        if self.times.len() == LATEST {
            self.times.pop_front();
        }
        self.times.push_back(time);
    }

    /// The age at which a slot of so many environments may get a backup lease; `None` before the first complete slot of this
    /// size.
    fn backup_age(&self, environments: usize) -> Option<Duration> {
        let median = self.median().filter(|_| environments == self.environments);
        median.map(|median| (median * BACKUP_AFTER).max(SHORTEST))
    }

    /// The median of the latest times, divided by the environments of a slot; `None` before the first complete slot.
    pub(super) fn for_each_environment(&self) -> Option<Duration> {
        let environments = u32::try_from(self.environments).unwrap_or(u32::MAX).max(1);
        self.median().map(|median| median / environments)
    }

    fn median(&self) -> Option<Duration> {
        let mut times = self.times.iter().copied().collect::<Vec<_>>();
        times.sort_unstable();
        times.get(times.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_slots_of_another_size_do_not_count() {
        let second = Duration::from_secs;
        let mut typical = TypicalTime::default();
        typical.add(second(20), 10);
        typical.add(second(20), 10);
        assert_eq!(typical.for_each_environment(), Some(second(2)));
        assert_eq!(typical.backup_age(10), Some(second(60)));
        assert_eq!(typical.backup_age(1), None);
        // A message costs more than its step.
        typical.add(second(7), 1);
        assert_eq!(typical.for_each_environment(), Some(second(7)));
        assert_eq!((typical.backup_age(1), typical.backup_age(10)), (Some(second(21)), None));
    }
}
