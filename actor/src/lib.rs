//! The actor process: leases work from the learner, steps environments with the newest weights and streams
//! trajectories back.
//!
//! An actor does not know the learning rule: a lease defines the rollout, the policy snapshot defines the actions
//! (crate [`rollout`]). [`run()`] is the main loop. Bounded queues connect the stepping thread to the network and to the
//! thread that writes the log (crate [`recording`]).

mod client;
pub mod config;
pub mod diagnosis;
pub mod error;
mod leasing;
mod outside;
pub mod run;
mod source;
mod stepping;

pub use config::{ActorConfig, Transport};
pub use error::{ActorError, EnvironmentError, causes};
pub use outside::{EnvironmentService, OutsideEnvironments, States};
pub use run::run;
