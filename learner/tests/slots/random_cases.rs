//! Reproducible random cases: the generator's seed is fixed and environment variables are ignored. A case that fails
//! becomes a named test.

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
    let rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let outcome = TestRunner::new_with_rng(config, rng).run(strategy, |value| {
        claim(value);
        Ok(())
    });
    if let Err(error) = outcome {
        panic!("{error}");
    }
}
