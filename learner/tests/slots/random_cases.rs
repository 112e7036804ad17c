//! Reproducible random cases: the generator's seed is fixed, unless the environment variable `SLOT_CASES_SEED` has
//! another one. A case that fails becomes a named test.

use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

/// Runs `claim` on `cases` values and panics with the smallest failing one.
pub(crate) fn for_all<S: Strategy>(cases: u32, strategy: &S, claim: impl Fn(S::Value)) {
    let defaults = Config::default();
    let config = Config {
        cases,
        failure_persistence: None,
        fork: false,
        timeout: 0,
        max_shrink_iters: 4096,
        ..defaults
    };
    let rng = match std::env::var("SLOT_CASES_SEED") {
        Ok(seed) => {
            let seed: u64 = seed.parse().expect("SLOT_CASES_SEED is a number");
            let mut bytes = [0; 32];
            bytes[..8].copy_from_slice(&seed.to_le_bytes());
            TestRng::from_seed(RngAlgorithm::ChaCha, &bytes)
        }
        Err(_) => TestRng::deterministic_rng(RngAlgorithm::ChaCha),
    };
    let outcome = TestRunner::new_with_rng(config, rng).run(strategy, |value| {
        claim(value);
        Ok(())
    });
    if let Err(error) = outcome {
        panic!("{error}");
    }
}
