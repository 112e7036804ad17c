//! The arguments of commands that query or control a running learner.

use std::time::Duration;

use clap::Args;

use crate::cli::tls::ClientTlsArguments;
use crate::errors::Usage;
use crate::run::newest;

/// Selects the learner.
#[derive(Args, Debug)]
pub(crate) struct LearnerArgument {
    /// Run folder, URL or HOST:PORT of the learner [default: the newest run in runs that has a learner, else the newest
    /// one, else http://127.0.0.1:50051].
    #[arg(value_name = "RUN | URL | HOST:PORT", default_value = "", hide_default_value = true, value_parser = newest::or_newest)]
    pub(crate) of: String,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ClientTlsArguments,
}

/// `s2mia status`
#[derive(Args, Debug)]
pub(crate) struct StatusArguments {
    /// Learner.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Print one JSON object.
    #[arg(long)]
    pub(crate) json: bool,
    /// Timeout for the learner's response.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    pub(crate) timeout_secs: f64,
}

/// `s2mia stop`
#[derive(Args, Debug)]
pub(crate) struct StopArguments {
    /// Learner.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Timeout for the learner's response.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    pub(crate) timeout_secs: f64,
}

/// `s2mia watch`
#[derive(Args, Debug)]
pub(crate) struct WatchArguments {
    /// Run folder or learner.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Omit the lines of iterations up to and including this one [default: 0].
    #[arg(long, value_name = "ITERATION")]
    pub(crate) after: Option<u64>,
    /// Print one JSON object per line.
    #[arg(long)]
    pub(crate) json: bool,
    /// Exit if the learner cannot be reached for this long.
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0)]
    pub(crate) max_outage_secs: f64,
}

/// Longest time that an option accepts, seconds: 31 years. Deadlines of calls cannot be much longer.
const LONGEST_SECS: f64 = 1e9;

/// The timeout that `--timeout-secs` gives.
pub(crate) fn patience(timeout_secs: f64) -> Result<Duration, Usage> {
    seconds("--timeout-secs", timeout_secs)
}

/// The time that `option` gives; refuses a negative, infinite or too long one.
pub(crate) fn seconds(option: &str, secs: f64) -> Result<Duration, Usage> {
    match (0.0..=LONGEST_SECS).contains(&secs) {
        true => Ok(Duration::from_secs_f64(secs)),
        false => Err(Usage::new(format!("{option} must be 0 to {LONGEST_SECS} s, is {secs:?}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_that_no_deadline_can_have_are_refused_in_one_line() {
        for secs in [-1.0, -1e300, f64::NAN, f64::INFINITY, 1e300, 1.1e9] {
            let line = seconds("--timeout-secs", secs).unwrap_err().to_string();
            assert_eq!(line, format!("--timeout-secs must be 0 to 1000000000 s, is {secs:?}"));
        }
        assert_eq!(seconds("--timeout-secs", 0.0).unwrap(), Duration::ZERO);
        assert_eq!(seconds("--timeout-secs", 1e9).unwrap(), Duration::from_secs(1_000_000_000));
    }
}
