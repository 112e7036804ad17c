//! Loads a robot's MJCF model, prints its links as JSON, and steps it with random controls.
//!
//! `cargo run --release -p sim --example model -- FOLDER DOCUMENT EPISODES STEPS`
//!
//! FOLDER has the model's files, and DOCUMENT is the path of the MJCF document in it. All episodes start in the rest
//! pose. The process fails if a number stops being finite.

#![expect(clippy::unwrap_used, reason = "an example that fails shows why")]

use std::path::PathBuf;
use std::sync::Arc;

use rand::RngCore as _;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng as _;
use serde_json::json;
use sim::{ModelFiles, Robot, World};

/// Physics steps in an environment step.
const FRAME_SKIP: u32 = 5;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().expect("the first argument is a folder"));
    let document = arguments.next().expect("the second argument is a document in the folder");
    let mut number = || arguments.next().map_or(0, |number| number.parse::<u32>().unwrap());
    let (episodes, steps) = (number(), number());
    let read = |path: &str| {
        std::fs::read(folder.join(path)).map_err(|error| format!("cannot read {path}: {error}"))
    };
    let built = ModelFiles::collect(&document, read)
        .and_then(|files| Ok((Robot::from_model(&document, &files, FRAME_SKIP)?, files)));
    let (robot, files) = built.unwrap_or_else(|error| {
        eprintln!("{error}");
        std::process::exit(1)
    });
    let mut world = World::new(Arc::new(robot));
    println!("{}", describe(&world, &files));
    let ranges: Vec<[f32; 2]> = world.robot().control_ranges().collect();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let (mut fastest, mut lowest) = (0.0_f32, 0.0_f32);
    let rest = world.robot().rest().to_vec();
    let mut speeds = vec![0.0; world.robot().velocity_names().len()];
    for episode in 0..episodes {
        world.rebuild(&rest, &vec![0.0; speeds.len()]);
        for step in 0..steps {
            let controls: Vec<f32> = ranges.iter().map(|range| draw(&mut random, *range)).collect();
            assert!(world.step(&controls), "not finite: episode {episode}, step {step}");
            world.velocities(&mut speeds);
            fastest = speeds.iter().fold(fastest, |most, speed| most.max(speed.abs()));
            lowest = lowest.min(world.lowest_point());
        }
    }
    assert!(fastest.is_finite() && lowest.is_finite());
    println!("{}", json!({ "steps": episodes * steps, "fastest": fastest, "lowest": lowest }));
}

/// Draws uniformly from a range.
fn draw(random: &mut ChaCha8Rng, [low, high]: [f32; 2]) -> f32 {
    low + (high - low) * (random.next_u32() >> 8) as f32 / 16_777_216.0
}

fn describe(world: &World, files: &ModelFiles) -> serde_json::Value {
    let robot = world.robot();
    let links: Vec<_> = robot
        .masses()
        .map(|(name, mass, moments)| json!({ "name": name, "mass": mass, "moments": moments }))
        .collect();
    json!({
        "files": files.files.keys().collect::<Vec<_>>(),
        "links": links,
        "centre": world.centre_of_mass(),
        "coordinates": robot.coordinate_names(),
        "actuators": robot.actuators().collect::<Vec<_>>(),
        "left_out": robot.left_out(),
    })
}
