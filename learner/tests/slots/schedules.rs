//! Random cases that are the same everywhere: the generator's seed is fixed and no environment variable
//! has a say. A case that once failed becomes a test with a name.

use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

/// Runs `claim` on `cases` values, and tells the smallest one that it does not hold for.
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
