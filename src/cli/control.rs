//! The arguments of what is asked of a learner at work.

use std::net::SocketAddr;

use clap::Args;

use super::ClientTlsArguments;

/// Which learner.
#[derive(Args, Debug)]
pub(crate) struct LearnerArgument {
    /// Run folder, or where the learner listens.
    #[arg(value_name = "RUN | URL", default_value = "http://127.0.0.1:50051")]
    pub(crate) of: String,
    /// TLS.
    #[command(flatten)]
    pub(crate) tls: ClientTlsArguments,
}

/// `s2mia status`
#[derive(Args, Debug)]
pub(crate) struct StatusArguments {
    /// Whose.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Print one JSON object.
    #[arg(long)]
    pub(crate) json: bool,
    /// How long to wait for the learner's answer.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    pub(crate) timeout_secs: f64,
}

/// `s2mia pause`, `resume` and `stop`
#[derive(Args, Debug)]
pub(crate) struct OrderArguments {
    /// Who is asked.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// How long to wait for the learner's answer.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    pub(crate) timeout_secs: f64,
}

/// `s2mia checkpoint`
#[derive(Args, Debug)]
pub(crate) struct CheckpointArguments {
    /// Who is asked.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// How long to wait for the checkpoint: an update that is going on is finished first.
    #[arg(long, value_name = "SECONDS", default_value_t = 600.0)]
    pub(crate) timeout_secs: f64,
}

const WATCH_CASES: &str = "\
What is watched:
  s2mia watch              lines of the learner at http://127.0.0.1:50051, until the run is finished
  s2mia watch URL          lines of the learner there
  s2mia watch RUN --lines  lines of whichever learner works on this run folder, also over restarts
  s2mia watch RUN          the robot and the learning curves of this run folder, live, until Ctrl-C:
                           open ws://127.0.0.1:8765 in Foxglove, with deploy/foxglove/s2mia.json";

/// `s2mia watch`
#[derive(Args, Debug)]
#[command(after_help = WATCH_CASES)]
pub(crate) struct WatchArguments {
    /// What is watched.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Print a line for each iteration of RUN instead of showing it live; a URL's are printed anyway.
    #[arg(long)]
    pub(crate) lines: bool,
    /// Leave out the lines of iterations up to this one [default: 0].
    #[arg(long, value_name = "ITERATION")]
    pub(crate) after: Option<u64>,
    /// Print one JSON object a line.
    #[arg(long)]
    pub(crate) json: bool,
    /// Give up the lines when the learner cannot be reached for this long [default: 300].
    #[arg(long, value_name = "SECONDS")]
    pub(crate) max_outage_secs: Option<f64>,
    /// Address of the live view [default: 127.0.0.1:8765].
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) listen: Option<SocketAddr>,
    /// Show it beyond this machine although nothing is encrypted and nobody is asked who they are.
    #[arg(long)]
    pub(crate) insecure_allow_remote: bool,
}

/// How `train` shows its run live.
#[derive(Args, Clone, Debug)]
pub(crate) struct LiveArguments {
    /// Show the robot and the learning curves live to Foxglove [default ADDRESS: 127.0.0.1:8765].
    #[arg(
        long,
        value_name = "ADDRESS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "127.0.0.1:8765",
        conflicts_with = "verify_determinism"
    )]
    pub(crate) watch: Option<SocketAddr>,
    /// Show it beyond this machine although nothing is encrypted and nobody is asked who they are.
    #[arg(long, requires = "watch")]
    pub(crate) insecure_allow_remote_watch: bool,
}
