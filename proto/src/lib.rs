//! Protocol between actor and learner: the `.proto` files, ids, domain types, conversions, and all message validation.
//! No sockets, no clock, no learning.
//!
//! Other crates use the domain types. Only files that face the network use the generated types in [`wire`]. A
//! domain type that this side sends has `to_wire`, which cannot fail; one that it receives has `from_wire`, which rejects
//! invalid messages with a [`Refusal`] that names the field.

mod acting;
mod actuator;
mod authorization;
pub mod calls;
mod digest;
mod environment;
mod episode_position;
mod episodes;
mod film;
mod ids;
mod left_out;
mod line;
pub mod name;
mod play;
mod read;
mod refusal;
mod returned;
mod run;
mod sizes;
mod status;
mod tensor;
mod trajectory;
pub mod trajectory_log;
pub mod validate;
pub mod wire;
mod work;

pub use acting::{ActStep, Acted, ActionChoice};
pub use actuator::{ActivationKind, ActuatorKind, ActuatorSpec};
pub use authorization::{AUTHORIZATION, Authorization};
pub use calls::{
    Ack, AckState, Heartbeat, HeartbeatAnswer, LeaseAnswer, PushHeader, Registered, Registration,
};
pub use digest::Digest;
pub use environment::{
    ActionSpec, AgentSpec, EnvironmentSpec, FeatureRole, FeatureSpec, LARGEST_ACTION,
    SpecDifference,
};
pub use episode_position::EpisodePosition;
pub use episodes::{Episodes, rollout_episode_id};
pub use film::{Film, MAX_CAPSULES, MAX_FRAMES};
pub use ids::{ActorId, Incarnation, LeaseId, PolicyVersion, ProcessId};
pub use line::{EvaluationSummary, RunEnd, RunLine};
pub use play::{PlayRequest, Steps, View, saved_state};
pub use refusal::{Reason, Refusal, in_words};
pub use returned::{LeaseFailure, ReturnedLease};
pub use run::RunDescription;
pub use status::{LeaseStatus, LeasedWork, Status};
pub use tensor::MAX_MAGNITUDE;
pub use trajectory::{AgentChunk, EvaluationResult, FinalStep, SlotEnd, TrajectoryChunk};
pub use work::{
    EnvironmentStart, EvaluationWork, Lease, RolloutOrigin, RolloutWork, Start, WeightsName, Work,
};

/// Encoded size of a message, bytes.
#[must_use]
pub fn wire_bytes(message: &impl prost::Message) -> usize {
    message.encoded_len()
}

/// Version of what the `.proto` files say. Both sides must have the same one.
pub const PROTOCOL_VERSION: u32 = 5;
/// Largest message in either direction, but for the description of a run, bytes.
pub const MAX_MESSAGE_BYTES: usize = 4 << 20;
/// Largest answer with the description of a run, bytes: it has the task's model twice, of 4 MiB at most.
pub const MAX_DESCRIPTION_BYTES: usize = 16 << 20;
/// Maximum number of unacknowledged messages of one stream.
pub const MAX_UNACKNOWLEDGED: usize = 4;
/// Longest time that the learner waits before it answers a lease request, milliseconds.
pub const MAX_LEASE_WAIT_MILLIS: u32 = 30_000;
