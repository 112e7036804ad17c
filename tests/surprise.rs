//! With a real robot's observations, what agents observe determines whether they share their surprise.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use learner::train::assemble::problem;
use marl::{AgentBatch, Batch, Surprise, SurpriseConfig};
use policy::RunSeed;
use policy::randomness::{Draw, DrawKey, Purpose};
use sim::EnvironmentBatch;

const STEPS: usize = 60;

fn base() -> toml::Table {
    std::fs::read_to_string("configs/base.toml").unwrap().parse().unwrap()
}

fn environments(mode: &str) -> Box<dyn EnvironmentBatch> {
    let mut observation = base()["observation"].clone();
    let table = observation.as_table_mut().unwrap();
    table.insert("mode".into(), mode.into());
    table.insert("norm".into(), "none".into());
    let config = sim::TaskConfig {
        task: "halfcheetah-2x3".to_owned(),
        definition: None,
        observation: observation.try_into().unwrap(),
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
    let key = DrawKey::of(RunSeed(1), Draw::of(Purpose::Probe));
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
fn intrinsic_rewards(mode: &str) -> Vec<Vec<f32>> {
    let mut environments = environments(mode);
    let config = SurpriseConfig { alpha: 0.01, ..base()["surprise"].clone().try_into().unwrap() };
    let problem = problem(environments.description());
    let mut surprise = Surprise::new(&config, &problem, RunSeed(1)).unwrap();
    let batch = shaken(&mut *environments);
    surprise.refit(&batch, 0).unwrap();
    surprise.relabel(&batch)
}

#[test]
fn agents_share_their_surprise_unless_their_observations_are_their_own() {
    let rewards = intrinsic_rewards("full_id");
    assert_eq!(rewards[0], rewards[1]);
    let rewards = intrinsic_rewards("k_nearest");
    assert_ne!(rewards[0], rewards[1]);
}
