//! SHA-256 digests, and the canonical bytes of pushed messages. The `.proto` comments document the same bytes in
//! Python.

use std::fmt;

use sha2::{Digest as _, Sha256};

use crate::{RolloutOrigin, wire};

/// A SHA-256, displayed as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest(pub [u8; 32]);

impl Digest {
    /// SHA-256 of `bytes`.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self(Sha256::digest(bytes).into())
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Digest({self})")
    }
}

/// The digest that `message TrajectoryChunk` documents, for the slot `origin`. Missing submessages count as empty: they are
/// refused by name elsewhere.
pub(crate) fn of_chunk(chunk: &wire::TrajectoryChunk, origin: &RolloutOrigin) -> Digest {
    let mut canonical = Canonical::new(b"s2mia.v1.TrajectoryChunk");
    canonical.0.update(origin.iteration.to_le_bytes());
    canonical.integers(&[origin.slot]);
    canonical.length(origin.environments.len());
    canonical.integers(&origin.environments);
    canonical.integers(&[chunk.sequence, chunk.first_step, chunk.steps]);
    for agent in &chunk.agents {
        canonical.tensors([&agent.observation, &agent.action, &agent.log_prob, &agent.hidden]);
    }
    canonical.tensors([&chunk.state, &chunk.reward, &chunk.terminated, &chunk.truncated]);
    let none = wire::FinalSteps::default();
    let finals = chunk.finals.as_ref().unwrap_or(&none);
    canonical.length(finals.steps.len());
    for (step, environment) in finals.steps.iter().zip(&finals.environments) {
        canonical.integers(&[*step, *environment]);
    }
    canonical.tensors([&finals.state]);
    finals.observations.iter().for_each(|tensor| canonical.blob(&tensor.data));
    canonical.0.update([u8::from(chunk.end.is_some())]);
    if let Some(end) = &chunk.end {
        end.environments.iter().for_each(|state| canonical.blob(state));
        end.recurrent.iter().for_each(|tensor| canonical.blob(&tensor.data));
    }
    canonical.terms(&chunk.reward_terms);
    canonical.finish()
}

/// The digest that `message EvaluationResult` documents, for the policies after `iteration`.
pub(crate) fn of_evaluation(result: &wire::EvaluationResult, iteration: u64) -> Digest {
    let mut canonical = Canonical::new(b"s2mia.v1.EvaluationResult");
    canonical.0.update(iteration.to_le_bytes());
    canonical.integers(&[result.episode]);
    canonical.0.update(result.extrinsic_return.to_le_bytes());
    canonical.integers(&[result.steps]);
    canonical.terms(&result.reward_terms);
    canonical.finish()
}

struct Canonical(Sha256);

impl Canonical {
    fn new(domain: &[u8]) -> Self {
        Self(Sha256::new_with_prefix(domain))
    }

    fn integers(&mut self, values: &[u32]) {
        values.iter().for_each(|value| self.0.update(value.to_le_bytes()));
    }

    fn length(&mut self, length: usize) {
        self.0.update((length as u64).to_le_bytes());
    }

    fn blob(&mut self, data: &[u8]) {
        self.length(data.len());
        self.0.update(data);
    }

    /// Sums of reward terms, of which an actor may send none.
    fn terms(&mut self, sums: &[f64]) {
        if !sums.is_empty() {
            self.blob(&sums.iter().flat_map(|sum| sum.to_le_bytes()).collect::<Vec<_>>());
        }
    }

    fn tensors<const N: usize>(&mut self, tensors: [&Option<wire::Tensor>; N]) {
        for tensor in tensors {
            self.blob(tensor.as_ref().map_or(&[], |tensor| &tensor.data));
        }
    }

    fn finish(self) -> Digest {
        Digest(self.0.finalize().into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_of_abc_is_the_published_one() {
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(Digest::of(b"abc").to_string(), expected);
    }

    #[test]
    fn an_evaluation_has_the_digest_that_python_computes() {
        // hashlib.sha256(b"s2mia.v1.EvaluationResult" + struct.pack("<QIdI", 7, 3, 1.5, 1000)).hexdigest()
        let (episode, extrinsic_return, reward_terms) = (3, 1.5, Vec::new());
        let mut result =
            wire::EvaluationResult { episode, extrinsic_return, steps: 1000, reward_terms };
        let expected = "6b3a218eabaa94b37908a403c1bb829da0416b542b6fa0504df2cdf63abafa0c";
        assert_eq!(of_evaluation(&result, 7).to_string(), expected);
        // The same bytes + struct.pack("<Q2d", 16, 2.0, -0.5).
        result.reward_terms = vec![2.0, -0.5];
        let expected = "119a655a6338fab4b5ee118ed63bcf88b46f2b180fd6d70fb2ddd2c154938089";
        assert_eq!(of_evaluation(&result, 7).to_string(), expected);
    }

    #[test]
    fn an_empty_chunk_has_the_digest_that_python_computes() {
        let chunk =
            wire::TrajectoryChunk { sequence: 1, first_step: 2, steps: 3, ..Default::default() };
        let expected = "515cee1f55e45a6f0b1d6a4bed53760d47aba14a10c4d88b55222eb2a0ba9b78";
        let origin = RolloutOrigin { iteration: 4, slot: 5, environments: vec![10, 11] };
        assert_eq!(of_chunk(&chunk, &origin).to_string(), expected);
        let other = RolloutOrigin { slot: 3, ..origin };
        assert_ne!(of_chunk(&chunk, &other).to_string(), expected);
    }
}
