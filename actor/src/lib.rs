//! Steps environments with the newest weights and streams trajectories to the learner.
//!
//! An actor does not know the learning rule: a lease defines the rollout, the policy snapshot defines the actions.
//! [`run()`] is the main loop of an actor process. Bounded queues connect the stepping thread to the network. A rollout
//! is a pure function of lease and weights ([`roll_out`]).

// Unit tests also use the fixture of the integration tests.
#[cfg(test)]
extern crate self as actor;

mod acting;
mod chunk;
mod client;
pub mod config;
pub mod error;
pub mod evaluation;
mod film;
pub mod identity;
mod leasing;
pub mod live;
mod outside;
pub mod recording;
pub mod rollout;
pub mod run;
mod source;
mod stepping;
pub mod trajectory_log;

pub use config::{Config, Transport};
pub use error::{ActorError, EnvironmentError, causes};
pub use evaluation::{Episode, EvaluationEpisode, PlayedStep, play_episode};
pub use identity::{environment_spec, rollout_fingerprint};
pub use live::{LiveError, LiveScene, LiveServer, LiveTopic};
pub use outside::{EnvironmentService, OutsideEnvironments, States};
pub use recording::{RecordError, RecordSummary, RecordedRun, record};
pub use rollout::roll_out;
pub use run::run;
pub use trajectory_log::{LogConfig, LogError, LogSettings};
