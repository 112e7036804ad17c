//! The arguments of commands that query or control a running learner.

use std::net::SocketAddr;
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

/// `s2mia pause`, `resume` and `stop`
#[derive(Args, Debug)]
pub(crate) struct OrderArguments {
    /// Learner.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Timeout for the learner's response.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    pub(crate) timeout_secs: f64,
}

/// `s2mia checkpoint`
#[derive(Args, Debug)]
pub(crate) struct CheckpointArguments {
    /// Learner.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Timeout for the checkpoint. The learner finishes an update in progress first.
    #[arg(long, value_name = "SECONDS", default_value_t = 600.0)]
    pub(crate) timeout_secs: f64,
}

const WATCH_CASES: &str = "\
Examples:
  s2mia watch              the newest run in runs, live, as s2mia watch RUN
  s2mia watch URL          lines of the learner at URL
  s2mia watch RUN --lines  lines of the run in this folder; continues when its learner restarts
  s2mia watch RUN          the robot and the learning curves of this run folder, live, until Ctrl-C:
                           open ws://127.0.0.1:8765 in Foxglove, with deploy/foxglove/s2mia.json";

/// `s2mia watch`
#[derive(Args, Debug)]
#[command(after_help = WATCH_CASES)]
pub(crate) struct WatchArguments {
    /// Run folder or learner.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Print one line per iteration of RUN instead of streaming it live; with a URL this is the default.
    #[arg(long)]
    pub(crate) lines: bool,
    /// Omit the lines of iterations up to and including this one [default: 0].
    #[arg(long, value_name = "ITERATION")]
    pub(crate) after: Option<u64>,
    /// Print one JSON object per line.
    #[arg(long)]
    pub(crate) json: bool,
    /// When printing lines, exit if the learner cannot be reached for this long [default: 300].
    #[arg(long, value_name = "SECONDS")]
    pub(crate) max_outage_secs: Option<f64>,
    /// Address of the live view [default: 127.0.0.1:8765].
    #[arg(long, value_name = "ADDRESS", value_parser = crate::listening::address)]
    pub(crate) listen: Option<SocketAddr>,
    /// Allow a non-loopback --listen address without encryption and authentication.
    #[arg(long)]
    pub(crate) insecure_allow_remote: bool,
}

/// The live view of `s2mia train`.
#[derive(Args, Clone, Debug)]
pub(crate) struct LiveArguments {
    /// Stream the robot and the learning curves live to Foxglove [default ADDRESS: 127.0.0.1:8765].
    #[arg(
        long,
        value_name = "ADDRESS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "127.0.0.1:8765",
        value_parser = crate::listening::address,
        conflicts_with = "verify_determinism"
    )]
    pub(crate) watch: Option<SocketAddr>,
    /// Allow a non-loopback --watch address without encryption and authentication.
    #[arg(long, requires = "watch")]
    pub(crate) insecure_allow_remote_watch: bool,
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
