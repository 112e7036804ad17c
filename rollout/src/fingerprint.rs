//! The numeric fingerprint of this program, for an actor's registration.

use std::sync::LazyLock;

use proto::Digest;
use sha2::{Digest as _, Sha256};

/// SHA-256 of the probes of simulator and policy. Programs with equal fingerprints compute equal rollouts. The first
/// call computes it, which takes a moment.
#[must_use]
pub fn rollout_fingerprint() -> Digest {
    static FINGERPRINT: LazyLock<Digest> = LazyLock::new(|| {
        let mut hash = Sha256::new();
        hash.update(sim::probe());
        hash.update(policy::probe());
        Digest(hash.finalize().into())
    });
    *FINGERPRINT
}
