//! The arguments of what is asked of a learner at work.

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

/// `s2mia watch`
#[derive(Args, Debug)]
pub(crate) struct WatchArguments {
    /// Who is watched.
    #[command(flatten)]
    pub(crate) learner: LearnerArgument,
    /// Leave out iterations up to this one.
    #[arg(long, value_name = "ITERATION", default_value_t = 0)]
    pub(crate) after: u64,
    /// Print one JSON object a line.
    #[arg(long)]
    pub(crate) json: bool,
    /// Give up when the learner cannot be reached for this long.
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0)]
    pub(crate) max_outage_secs: f64,
}
