//! What actors and the learner say to each other: ids, domain types, the `.proto` files and their
//! conversions, and the one place where a message is checked. No sockets, no clock, no learning.
//!
//! Code outside speaks the domain types; the generated ones, under [`wire`], are for the two files that
//! face the network. Every domain type has `to_wire`, which cannot fail, and `from_wire`, which refuses
//! what is wrong with a [`Refusal`] that names the field.

mod acting;
pub mod calls;
mod digest;
mod environment;
mod episodes;
mod film;
mod ids;
mod line;
mod play;
mod read;
mod refusal;
mod run;
mod share_rewards;
mod status;
mod tensor;
mod trajectory;
pub mod trajectory_log;
pub mod validate;
pub mod wire;
mod work;

pub use acting::{
    ActStep, Acted, ActionChoice, ActionDistribution, PolicyAgent, PolicyDescription,
};
pub use calls::{
    Ack, AckState, Beat, HeartbeatAnswer, LeaseAnswer, PushHeader, Registered, Registration,
    RunState,
};
pub use digest::Digest;
pub use environment::{
    ActionSpec, AgentSpec, Difference, EnvironmentSpec, FeatureRole, FeatureSpec,
};
pub use episodes::{Episodes, rollout_episode_id};
pub use film::{Film, MAX_CAPSULES, MAX_FRAMES};
pub use ids::{ActorId, Incarnation, LeaseId, PolicyVersion};
pub use line::{EvaluationSummary, RunEnd, RunLine};
pub use play::{PlayRequest, Steps, View, saved_state};
pub use refusal::{ERROR_DOMAIN, Reason, Refusal, in_words};
pub use run::RunDescription;
pub use share_rewards::{ShareRewards, is_reward_log_name, reward_log_name};
pub use status::{LeaseStatus, LeasedWork, Status};
pub use trajectory::{AgentChunk, EvaluationResult, FinalStep, SlotEnd, TrajectoryChunk};
pub use work::{
    EnvironmentStart, EvaluationWork, Lease, RolloutOrigin, RolloutWork, Start, WeightsName, Work,
};

/// Bytes that a message takes on the wire.
#[must_use]
pub fn wire_bytes(message: &impl prost::Message) -> usize {
    message.encoded_len()
}

/// Version of what the `.proto` files say. Both sides must have the same one.
pub const PROTOCOL_VERSION: u32 = 3;
/// Largest message in either direction, bytes.
pub const MAX_MESSAGE_BYTES: usize = 4 << 20;
/// Largest piece of a policy snapshot, bytes.
pub const MAX_WEIGHTS_PIECE_BYTES: usize = 1 << 20;
/// Messages of one stream that may wait for their acknowledgement.
pub const MAX_UNACKNOWLEDGED: usize = 4;
/// Longest wait for a lease that the learner grants, milliseconds.
pub const MAX_LEASE_WAIT_MILLIS: u32 = 30_000;
