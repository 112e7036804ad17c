//! Which weights an iteration is rolled out with.

use proto::PolicyVersion;

/// How many updates behind the weights are that roll out. With none an iteration waits for the update before it;
/// with one it is rolled out beside that update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    policy_lag: u64,
}

impl Schedule {
    /// Rolls out `policy_lag` updates behind.
    #[must_use]
    pub fn new(policy_lag: u64) -> Self {
        Self { policy_lag }
    }

    /// The weights that roll out `iteration`: those `policy_lag` versions before it, or the first.
    #[must_use]
    pub fn behaviour(self, iteration: u64) -> PolicyVersion {
        PolicyVersion(iteration.saturating_sub(self.policy_lag))
    }

    /// Versions from those that roll out `iteration` to the newest that there are then, both included.
    #[must_use]
    pub fn versions(self, iteration: u64) -> usize {
        (iteration - self.behaviour(iteration).0) as usize + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn with_a_lag_of_one_the_first_two_iterations_are_rolled_out_with_the_first_weights() {
        let rolled_out = |lag| [0, 1, 2, 7].map(|k| Schedule::new(lag).behaviour(k).0);
        assert_eq!(rolled_out(0), [0, 1, 2, 7]);
        assert_eq!(rolled_out(1), [0, 0, 1, 6]);
        assert_eq!([0, 1, 2].map(|k| Schedule::new(1).versions(k)), [1, 2, 2]);
    }
}
