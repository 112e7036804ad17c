//! Metrics of the reward's terms. They depend neither on actors nor on how environments are cut into slots.

use crate::lease::slots::SlotRollout;

/// Mean of each of these terms in an environment step of an iteration, as `reward/TERM`; empty if an actor left terms out.
pub(crate) fn means_per_step(names: &[String], rollouts: &[SlotRollout]) -> Vec<(String, f64)> {
    let chunks = || rollouts.iter().flat_map(|rollout| &rollout.chunks);
    if chunks().any(|chunk| chunk.reward_terms.is_empty()) {
        return Vec::new();
    }
    let steps: usize = chunks().map(|chunk| chunk.reward.len()).sum();
    let mean = |(term, name): (usize, &String)| {
        let place = |environment: usize| environment * names.len() + term;
        // The sum of each environment comes first: slots have any number of them.
        let of_slot = |rollout: &'_ SlotRollout| -> Vec<f64> {
            let sum = |environment| {
                rollout.chunks.iter().map(|chunk| chunk.reward_terms[place(environment)]).sum()
            };
            (0..rollout.environments()).map(sum).collect()
        };
        let sum: f64 = rollouts.iter().flat_map(of_slot).sum();
        (format!("reward/{name}"), sum / steps as f64)
    };
    names.iter().enumerate().map(mean).collect()
}

/// Mean over episodes of the sum of each of these terms in an episode, `[K]`, as `return/TERM`; empty if an actor left terms
/// out.
#[must_use]
pub fn means_per_episode(names: &[String], episodes: &[&[f64]]) -> Vec<(String, f64)> {
    if episodes.iter().any(|terms| terms.is_empty()) {
        return Vec::new();
    }
    let mean = |(term, name): (usize, &String)| {
        let sum: f64 = episodes.iter().map(|terms| terms[term]).sum();
        (format!("return/{name}"), sum / episodes.len() as f64)
    };
    names.iter().enumerate().map(mean).collect()
}

#[cfg(test)]
mod tests {
    use proto::{ActorId, LeaseId, TrajectoryChunk};

    use super::*;

    const NAMES: [&str; 2] = ["forward_speed", "control"];

    /// A slot of two chunks of two steps, with the sums of the terms of each chunk, `[E, 2]`.
    fn slot(slot: u32, terms: [&[f64]; 2]) -> SlotRollout {
        let chunk = |terms: &[f64]| TrajectoryChunk {
            steps: 2,
            reward: vec![0.0; terms.len().max(2)],
            reward_terms: terms.to_vec(),
            ..TrajectoryChunk::default()
        };
        let chunks = terms.map(chunk).to_vec();
        SlotRollout { slot, actor: ActorId(1), lease: LeaseId(1), chunks, digests: Vec::new() }
    }

    #[test]
    fn means_are_equal_for_every_cut_into_slots_and_absent_if_an_actor_leaves_terms_out() {
        let names = NAMES.map(str::to_owned);
        // Sums of 0.1, 0.2 and 0.3 depend on their order.
        let whole = [slot(0, [&[0.1, 4.0, 0.3, 0.0, 0.6, 0.0], &[0.2, 0.0, 0.1, 0.0, 0.7, 8.0]])];
        let cut = [
            slot(0, [&[0.1, 4.0], &[0.2, 0.0]]),
            slot(1, [&[0.3, 0.0, 0.6, 0.0], &[0.1, 0.0, 0.7, 8.0]]),
        ];
        let means = means_per_step(&names, &whole);
        // Three environments take four steps.
        let forward_speed = ((0.1 + 0.2) + (0.3 + 0.1) + (0.6 + 0.7)) / 12.0;
        let expected = [("reward/forward_speed", forward_speed), ("reward/control", 1.0)];
        assert_eq!(means, expected.map(|(name, mean)| (name.to_owned(), mean)));
        assert_eq!(means_per_step(&names, &cut), means);
        let [first, _] = cut;
        assert!(means_per_step(&names, &[first, slot(1, [&[], &[]])]).is_empty());
    }

    #[test]
    fn an_evaluation_has_the_mean_of_each_terms_sum_in_an_episode() {
        let names = NAMES.map(str::to_owned);
        let means = means_per_episode(&names, &[&[10.0, -1.0], &[20.0, -4.0]]);
        let expected = [("return/forward_speed", 15.0), ("return/control", -2.5)];
        assert_eq!(means, expected.map(|(name, mean)| (name.to_owned(), mean)));
        assert!(means_per_episode(&names, &[&[10.0, -1.0], &[]]).is_empty());
    }
}
