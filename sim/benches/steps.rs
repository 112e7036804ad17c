//! Environment steps per second on one core, for each robot, compared with MuJoCo on the same core in the same run.
//!
//! `cargo bench -p sim` prints our rates. With `MUJOCO_PYTHON=venv/bin/python`, an interpreter with `mujoco` and
//! `gymnasium`, it also times MuJoCo's C step between our measurements and prints the ratio of the medians.

use std::process::Command;
use std::time::Instant;

use rand::RngCore;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use sim::{Outcome, TaskConfig};

/// Task of each robot and its model in Gymnasium.
const ROBOTS: [(&str, &str); 3] =
    [("halfcheetah-6x1", "half_cheetah"), ("walker2d-2x3", "walker2d"), ("ant-4x2", "ant")];
const REPEATS: usize = 7;
const STEPS: usize = 3_000;

fn main() {
    let python = std::env::var("MUJOCO_PYTHON").ok();
    println!("environment steps per second on one core, median of {REPEATS} runs of {STEPS} steps");
    println!("{:<16} {:>10} {:>10} {:>8}", "robot", "ours", "MuJoCo", "ratio");
    for (task, model) in ROBOTS {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for _ in 0..REPEATS {
            ours.push(our_rate(task));
            theirs.extend(python.as_deref().and_then(|python| mujoco_rate(python, model)));
        }
        let ours = median(ours);
        if theirs.is_empty() {
            println!("{task:<16} {ours:>10.0} {:>10} {:>8}", "-", "-");
        } else {
            let theirs = median(theirs);
            println!("{task:<16} {ours:>10.0} {theirs:>10.0} {:>8.2}", ours / theirs);
        }
    }
}

/// Steps per second under uniform random actions, resets included.
fn our_rate(task: &str) -> f64 {
    let config: TaskConfig = serde_json::from_value(serde_json::json!({
        "task": task,
        "observation": {
            "mode": "full_id", "norm": "none", "nearest": 1, "globals": "hidden",
            "contact_forces": "absent",
        },
    }))
    .expect("the settings are valid");
    let mut world = sim::environments(&config, 1).expect("the task is known");
    let size = world.description().agents.iter().map(|agent| agent.action.size).sum();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut actions, mut outcome) = (vec![0.0_f32; size], [Outcome::default()]);
    world.reset(0, 0, 1000, [0; 32]).expect("the simulator resets");
    let start = Instant::now();
    for _ in 0..STEPS {
        for action in &mut actions {
            *action = (rng.next_u32() >> 8) as f32 / 8_388_608.0 - 1.0;
        }
        world.step(&actions, &mut outcome).expect("the actions are finite");
        if outcome[0].terminated || outcome[0].truncated {
            world.reset(0, 0, 1000, [0; 32]).expect("the simulator resets");
        }
    }
    STEPS as f64 / start.elapsed().as_secs_f64()
}

/// Rate that `mujoco_rate.py` prints for a model.
fn mujoco_rate(python: &str, model: &str) -> Option<f64> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/mujoco_rate.py");
    let output = Command::new(python).args([script, model, &STEPS.to_string()]).output().ok()?;
    String::from_utf8(output.stdout).ok()?.trim().parse().ok()
}

fn median(mut rates: Vec<f64>) -> f64 {
    rates.sort_by(f64::total_cmp);
    rates[rates.len() / 2]
}
