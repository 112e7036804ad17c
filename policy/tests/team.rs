//! Trained teams in environments that another program steps.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{ActorNetwork, ActorPolicy, CoreKind, Head, PolicySnapshot, Team, probe};

/// Number of observation features of both agents.
const FEATURES: usize = 5;

/// A recurrent agent with two numbers as its action, and one without memory that makes a choice.
fn snapshot() -> PolicySnapshot {
    let agent = |core, action, head| -> ActorPolicy {
        let mut rng = generator(RunSeed(1), Draw::of(Purpose::Initialisation));
        let network =
            ActorNetwork::new(&probe::config(core), FEATURES, action, head, &mut rng).unwrap();
        network.policy().unwrap()
    };
    let continuous = agent(CoreKind::Gru, 2, Head::Gaussian);
    let choosing = agent(CoreKind::Mlp, 1, Head::Categorical { choices: 5 });
    PolicySnapshot { agents: vec![continuous, choosing] }
}

/// Observations of one environment.
fn row(environment: usize) -> Vec<f32> {
    (0..FEATURES).map(|feature| (3 * environment + feature) as f32 / 7.0 - 1.0).collect()
}

/// Actions of both agents in two steps, `[E, act]` each.
fn acted(team: &mut Team, policy: &PolicySnapshot, rows: &[f32]) -> Vec<Vec<f32>> {
    let agents = [0, 1, 0, 1];
    agents.map(|agent| team.act(policy, agent, rows)).to_vec()
}

#[test]
fn an_environment_of_a_batch_has_the_bits_that_it_has_alone() {
    let policy = snapshot();
    let rows = [0, 1, 2].map(row).concat();
    let together = acted(&mut Team::new(&policy, 3, None), &policy, &rows);
    for environment in 0..3 {
        let alone = acted(&mut Team::new(&policy, 1, None), &policy, &row(environment));
        for (all, own) in together.iter().zip(alone) {
            assert_eq!(all[environment * own.len()..][..own.len()], own);
        }
    }
    let seed = Some(RunSeed(3));
    let together = acted(&mut Team::new(&policy, 3, seed), &policy, &row(0).repeat(3));
    let alone = acted(&mut Team::new(&policy, 1, seed), &policy, &row(0));
    assert_eq!(together[0][..2], alone[0]);
    assert_ne!(together[0][..2], together[0][2..4], "each environment has its own draws");
}

#[test]
fn a_reset_forgets_the_episode_of_one_environment_and_draws_anew() {
    let policy = snapshot();
    let rows = [0, 1].map(row).concat();
    let mut team = Team::new(&policy, 2, None);
    let first = acted(&mut team, &policy, &rows);
    team.reset(1);
    let second = acted(&mut team, &policy, &rows);
    assert_ne!(second[0][..2], first[0][..2], "the first environment continues");
    assert_eq!(second[0][2..], first[0][2..]);

    let mut sampling = Team::new(&policy, 2, Some(RunSeed(3)));
    let first = acted(&mut sampling, &policy, &rows);
    sampling.reset(1);
    assert_ne!(acted(&mut sampling, &policy, &rows)[0][2..], first[0][2..]);
}

#[test]
fn an_episode_without_a_step_is_not_counted() {
    let policy = snapshot();
    let second_episode = |resets: [usize; 2]| {
        let mut team = Team::new(&policy, 1, Some(RunSeed(3)));
        (0..resets[0]).for_each(|_| team.reset(0));
        acted(&mut team, &policy, &row(0));
        (0..resets[1]).for_each(|_| team.reset(0));
        acted(&mut team, &policy, &row(0))
    };
    assert_eq!(second_episode([0, 1]), second_episode([2, 3]));
}
