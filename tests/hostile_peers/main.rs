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

use std::sync::LazyLock;

use learners::{Learner, inspect};
use serde_json::Value;

/// The state in which a run ends without disturbance; it is trained once.
static UNDISTURBED: LazyLock<Value> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    Learner::start(&run, &[]).finish(&[]);
    inspect(&run)
});
