//! Differences between a robot's motion and MuJoCo's for a second set of controls and starts.

use std::sync::Arc;

use serde_json::Value;
use sim::{Robot, World};

use crate::compare::numbers;

/// Names and descriptions of the controls and starts.
pub(crate) const DRIVES: [(&str, &str); 6] = [
    ("square_slow", "square wave 0.5 Hz"),
    ("square_fast", "square wave 2 Hz"),
    ("one_leg", "torque in one leg"),
    ("drop", "drop"),
    ("forward", "3 m/s"),
    ("spin", "spin 3 rad/s"),
];

/// Mean absolute differences over starts and times.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Errors {
    /// Error of the root's x position, m.
    pub(crate) place: f64,
    /// Error of the root's height, m.
    pub(crate) height: f64,
    /// Error of a planar root's pitch, rad; 0 for a free root.
    pub(crate) pitch: f64,
    /// Mean error of the hinge angles, rad.
    pub(crate) angle: f64,
}

/// MuJoCo's recorded traces and statistics.
pub(crate) struct HeldOut(Value);

impl HeldOut {
    pub(crate) fn read() -> Self {
        let text = include_str!("../../tests/data/mujoco-held-out.json");
        Self(serde_json::from_str(text).expect("the recorded traces are JSON"))
    }

    pub(crate) fn source(&self) -> &str {
        self.0["source"].as_str().expect("the traces name their source")
    }

    /// MuJoCo's statistics under uniform random actions.
    pub(crate) fn random(&self, name: &str) -> &Value {
        &self.0["robots"][name]["random"]
    }

    /// Errors of this simulator, and those of MuJoCo between the task's step and a quarter of it.
    pub(crate) fn errors(&self, (name, task): (&str, &str), drive: &str) -> [Errors; 2] {
        let robot = Arc::new(Robot::of_task(task).expect("the task is known"));
        let episodes =
            self.0["robots"][name]["traces"][drive].as_array().expect("a list of starts");
        let (mut ours, mut own) = (Vec::new(), Vec::new());
        for episode in episodes {
            let coarse = rows(&episode["task_step"]);
            add(&mut ours, &robot, &self.play(&robot, episode), &coarse);
            add(&mut own, &robot, &coarse, &rows(&episode["quarter_step"]));
        }
        [mean(&ours), mean(&own)]
    }

    /// The model's own coordinates at the recorded times.
    fn play(&self, robot: &Arc<Robot>, episode: &Value) -> Vec<Vec<f64>> {
        let mut world = World::new(Arc::clone(robot));
        let reference = robot.reference();
        let start = numbers(&episode["start"]);
        let start: Vec<f32> = start.iter().zip(reference).map(|(q, r)| *q as f32 - r).collect();
        world.rebuild(&start, &singles(&episode["motion"]));
        let hold_secs = self.0["hold_secs"].as_f64().expect("a number");
        let steps = (hold_secs / robot.physics_step_secs()).round() as u32;
        let times = numbers(&self.0["times_secs"]);
        let mut seen = Vec::new();
        for (segment, row) in episode["controls"].as_array().expect("a list").iter().enumerate() {
            world.command(&singles(row));
            for _ in 0..steps {
                assert!(world.substep(), "the state is finite");
            }
            let now = (segment + 1) as f64 * hold_secs;
            if times.iter().any(|time| (time - now).abs() < 1e-9) {
                let mut at = vec![0.0; reference.len()];
                world.coordinates(&mut at);
                let model = |(q, r): (&f32, &f32)| f64::from(*q) + f64::from(*r);
                seen.push(at.iter().zip(reference).map(model).collect());
            }
        }
        seen
    }
}

fn add(errors: &mut Vec<Errors>, robot: &Robot, seen: &[Vec<f64>], expected: &[Vec<f64>]) {
    let hinges = robot.hinges().count();
    for (got, want) in seen.iter().zip(expected) {
        let off: Vec<f64> = got.iter().zip(want).map(|(g, w)| (g - w).abs()).collect();
        let angles = &off[off.len() - hinges..];
        let planar = off.len() == hinges + 3;
        errors.push(Errors {
            place: off[0],
            height: if planar { off[1] } else { off[2] },
            pitch: if planar { off[2] } else { 0.0 },
            angle: angles.iter().sum::<f64>() / hinges as f64,
        });
    }
}

/// The mean of each error.
pub(crate) fn mean(errors: &[Errors]) -> Errors {
    let of = |part: fn(&Errors) -> f64| errors.iter().map(part).sum::<f64>() / errors.len() as f64;
    Errors {
        place: of(|e| e.place),
        height: of(|e| e.height),
        pitch: of(|e| e.pitch),
        angle: of(|e| e.angle),
    }
}

fn rows(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().expect("a list of times").iter().map(numbers).collect()
}

fn singles(value: &Value) -> Vec<f32> {
    numbers(value).iter().map(|number| *number as f32).collect()
}
