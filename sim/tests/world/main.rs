//! Tests of the simulator: physics, restoring, bounds, observations, and MuJoCo's traces.

#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod bounds;
mod carry;
mod fidelity;
mod hostile;
mod humanoid;
mod observations;
mod pushed;
mod rebuild;
mod robots;
mod views;

use std::sync::Arc;

use rand::RngCore;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use sim::{EnvironmentBatch, Outcome, Robot, TaskConfig, World};

fn config(task: &str, norm: &str) -> TaskConfig {
    serde_json::from_value(serde_json::json!({
        "task": task, "observation": {
            "mode": "full_id", "norm": norm, "nearest": 1, "globals": "hidden",
            "contact_forces": "absent",
        },
    }))
    .unwrap()
}

fn environments(task: &str, count: usize) -> Box<dyn EnvironmentBatch> {
    sim::environments(&config(task, "feature_z"), count).unwrap()
}

fn cheetah() -> World {
    World::new(Arc::new(Robot::of_task("halfcheetah-2x3").unwrap()))
}

fn seeded(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Draws a reset key.
fn key(rng: &mut ChaCha8Rng) -> [u8; 32] {
    let mut key = [0; 32];
    rng.fill_bytes(&mut key);
    key
}

/// Draws uniformly from [-1, 1).
fn uniform(rng: &mut ChaCha8Rng) -> f32 {
    (rng.next_u32() >> 8) as f32 / 8_388_608.0 - 1.0
}

fn random_actions(rng: &mut ChaCha8Rng, actions: &mut [f32]) {
    actions.iter_mut().for_each(|action| *action = uniform(rng));
}

/// Steps the only environment.
fn step(world: &mut dyn EnvironmentBatch, actions: &[f32]) -> Outcome {
    let mut outcome = [Outcome::default()];
    world.step(actions, &mut outcome).unwrap();
    outcome[0]
}

fn coordinates(world: &World) -> Vec<f32> {
    let mut out = vec![0.0; world.robot().coordinate_names().len()];
    world.coordinates(&mut out);
    out
}

fn velocities(world: &World) -> Vec<f32> {
    let mut out = vec![0.0; world.robot().velocity_names().len()];
    world.velocities(&mut out);
    out
}
