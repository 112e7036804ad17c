//! A learner with hostile peers, as real processes: invalid messages, many peers, stalled connections, and lost actors.
//! Its memory and descriptors stay bounded, it logs each incident, and it ends with the weights of an undisturbed run.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "../system/attackers.rs"]
mod attackers;
mod http2_frames;
mod incidents;
mod invalid_messages;
#[path = "../system/learners.rs"]
mod learners;
mod many_peers;
mod resource_limits;
mod stalled_connections;
mod usage;
