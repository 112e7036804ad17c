//! With a real robot's observations, the space in which surprise is measured determines whether
//! agents share it.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use learner::train::assemble::problem;
use marl::{AgentBatch, Batch, Surprise, SurpriseConfig};
use policy::RunSeed;
use policy::randomness::{Draw, Key, Purpose};
use sim::EnvironmentBatch;

const STEPS: usize = 60;

fn base() -> toml::Table {
    std::fs::read_to_string("configs/base.toml").unwrap().parse().unwrap()
}

fn environments(mode: &str, norm: &str) -> Box<dyn EnvironmentBatch> {
    let mut observation = base()["observation"].clone();
    let table = observation.as_table_mut().unwrap();
    table.insert("mode".into(), mode.into());
    table.insert("norm".into(), norm.into());
    let config = sim::TaskConfig {
        task: "halfcheetah-2x3".to_owned(),
        definition: None,
        observation: observation.try_into().unwrap(),
        partition: base()["partition"]["semantics"].clone().try_into().unwrap(),
    };
    sim::environments(&config, 1).unwrap()
}

/// Observations of two agents of a HalfCheetah under periodic actions.
fn shaken(environments: &mut dyn EnvironmentBatch) -> Batch {
    let width = environments.description().agents[0].observation.len();
    let mut batch = Batch {
        steps: STEPS,
        environments: 1,
        agents: vec![AgentBatch::default(); 2],
        reward: vec![0.0; STEPS],
        ..Batch::default()
    };
    let key = Key::of(RunSeed(1), Draw::of(Purpose::Probe));
    environments.reset(0, 0, 1000, key.0).unwrap();
    for step in 0..STEPS {
        let mut state = vec![0.0; environments.description().state.len()];
        environments.state(0, &mut state);
        batch.state.extend(state);
        for (agent, data) in batch.agents.iter_mut().enumerate() {
            let mut seen = vec![0.0; width];
            environments.observation(0, agent, &mut seen);
            data.observation.extend(seen);
        }
        let action: Vec<f32> =
            (0..6).map(|joint| ((step * (joint + 2)) % 7) as f32 / 3.0 - 1.0).collect();
        environments.step(&action, &mut [sim::Outcome::default()]).unwrap();
    }
    batch
}

/// Every agent's intrinsic rewards; the task's reward is zero.
fn paid(environments: &mut dyn EnvironmentBatch, space: &str) -> Vec<Vec<f32>> {
    let mut surprise = base()["surprise"].clone();
    let table = surprise.as_table_mut().unwrap();
    table.insert("alpha".into(), 0.01.into());
    table.insert("space".into(), space.into());
    let config: SurpriseConfig = surprise.try_into().unwrap();
    let problem = problem(environments.description());
    let mut surprise = Surprise::new(&config, &problem, RunSeed(1)).unwrap();
    let batch = shaken(environments);
    surprise.refit(&batch, 0).unwrap();
    surprise.relabel(&batch)
}

#[test]
fn agents_with_full_observations_share_their_surprise_unless_it_is_local() {
    let mut environments = environments("full_id", "feature_z");
    for shared in ["policy_obs", "raw"] {
        let rewards = paid(&mut *environments, shared);
        assert_eq!(rewards[0], rewards[1], "{shared}");
    }
    let rewards = paid(&mut *environments, "local");
    assert_ne!(rewards[0], rewards[1]);
}

#[test]
fn raw_surprise_does_not_depend_on_the_scaling_of_observations() {
    let raw = paid(&mut *environments("full_id", "feature_z"), "raw");
    assert_eq!(paid(&mut *environments("full_id", "none"), "raw"), raw);
    assert_eq!(paid(&mut *environments("full_id", "none"), "policy_obs"), raw);
    assert_ne!(paid(&mut *environments("full_id", "feature_z"), "policy_obs"), raw);
}

#[test]
fn local_surprise_equals_that_of_nearest_observations() {
    let local = paid(&mut *environments("full_id", "feature_z"), "local");
    assert_eq!(paid(&mut *environments("k_nearest", "none"), "policy_obs"), local);
}
