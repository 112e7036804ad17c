//! The fall of a robot from its start, for `tests/reference/public_models.py`.

use std::path::Path;
use std::sync::Arc;

use sim::{Robot, World};

/// Duration of a fall, s.
const SECS: f64 = 0.25;

/// Coordinates after a fall without controls, in the model's own frame, or the reason for a refusal, as JSON.
pub(crate) fn report(folder: &str, document: &str) -> serde_json::Value {
    let read = |path: &str| {
        std::fs::read(Path::new(folder).join(path)).map_err(|error| format!("{path}: {error}"))
    };
    match Robot::of_model(document, read) {
        Err(refusal) => serde_json::json!({ "refused": refusal.to_string() }),
        Ok(robot) => fall(Arc::new(robot)),
    }
}

fn fall(robot: Arc<Robot>) -> serde_json::Value {
    let mut world = World::new(Arc::clone(&robot));
    let controls = vec![0.0; robot.actuators().count()];
    let steps = (SECS / robot.physics_step_secs()).round() as u32;
    let is_stable = (0..steps).all(|_| world.step(&controls));
    let mut coordinates = robot.rest().to_vec();
    world.coordinates(&mut coordinates);
    for (coordinate, reference) in coordinates.iter_mut().zip(robot.reference()) {
        *coordinate += reference;
    }
    let [left_out, names] = [robot.left_out(), robot.coordinate_names()];
    serde_json::json!({
        "steps": steps, "stable": is_stable, "names": names, "coordinates": coordinates,
        "left_out": left_out,
    })
}
