//! How long silence may last.

use serde::{Deserialize, Serialize};

use crate::config::ConfigError;

/// How long an actor may be silent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeaseConfig {
    /// A lease ends when nothing is heard of it for this long, seconds.
    pub ttl_secs: f64,
    /// Time between two heartbeats of an actor, seconds; less than the time to live.
    pub heartbeat_secs: f64,
}

impl LeaseConfig {
    /// Refuses times that no run can work with.
    ///
    /// # Errors
    /// Names the first key that is wrong and its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let within = |key, value: f64, low: f64, high: f64| {
            let good = (low..=high).contains(&value);
            let range = format!("{low} to {high}");
            good.then_some(()).ok_or_else(|| ConfigError { key, found: value.to_string(), range })
        };
        within("lease.ttl_secs", self.ttl_secs, 0.1, 3600.0)?;
        within("lease.heartbeat_secs", self.heartbeat_secs, 0.01, self.ttl_secs / 2.0)
    }
}
