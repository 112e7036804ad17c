//! Secret samples of an actor's work: which slots are audited and which chunks are checked whole.

use std::hash::{BuildHasher as _, Hasher as _, RandomState};

use sha2::{Digest as _, Sha256};

/// A share of all keys. Whether it covers a key is a function of the key and the secret.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecretSample {
    /// Share of the keys, 0 to 1.
    pub share: f64,
    /// Secret of this start of the learner: no actor can know which keys are covered. No result depends on it.
    pub secret: u64,
}

impl SecretSample {
    /// Covers nothing.
    pub const NONE: Self = Self { share: 0.0, secret: 0 };

    /// A sample with a new secret.
    #[must_use]
    pub fn new(share: f64) -> Self {
        Self { share, secret: random_number() }
    }

    /// Whether the sample covers `key`.
    #[must_use]
    pub fn covers(self, key: [u64; 2]) -> bool {
        let mut hash = Sha256::new_with_prefix(self.secret.to_le_bytes());
        key.iter().for_each(|part| hash.update(part.to_le_bytes()));
        let first = hash.finalize().first_chunk::<8>().copied().unwrap_or_default();
        // Both are exact at 0 and 1.
        (u64::from_le_bytes(first) as f64) < self.share * (u64::MAX as f64)
    }
}

/// A number that no peer can guess. No result depends on it.
pub(crate) fn random_number() -> u64 {
    // The standard library keys its hashers from the system's random source.
    RandomState::new().build_hasher().finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_covers_its_share_of_the_keys() {
        let covered = |share| {
            let sample = SecretSample { share, secret: 7 };
            (0..10_000).filter(|first| sample.covers([*first, 3])).count()
        };
        assert_eq!((covered(0.0), covered(1.0)), (0, 10_000));
        assert!((70..130).contains(&covered(0.01)), "{}", covered(0.01));
    }

    #[test]
    fn another_secret_and_each_part_of_the_key_give_another_sample() {
        let covered = |sample: SecretSample, key: fn(u64) -> [u64; 2]| {
            (0..256).map(|number| sample.covers(key(number))).collect::<Vec<_>>()
        };
        let sample = SecretSample { share: 0.5, secret: 7 };
        let first = covered(sample, |number| [number, 0]);
        assert_ne!(first, covered(SecretSample { secret: 8, ..sample }, |number| [number, 0]));
        assert_ne!(first, covered(sample, |number| [number, 1]));
        assert_ne!(first, covered(sample, |number| [0, number]));
    }
}
