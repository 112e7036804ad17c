//! Differences between a robot's motion and MuJoCo's recorded motion.

use std::sync::Arc;

use serde_json::Value;
use sim::{Robot, World};

/// Robots of the traces, with one task each.
pub(crate) const ROBOTS: [(&str, &str); 3] =
    [("halfcheetah", "halfcheetah-2x3"), ("walker2d", "walker2d-2x3"), ("ant", "ant-2x4")];

/// Mean differences at one time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Difference {
    /// Difference of the root's x position, m.
    pub(crate) place: f64,
    /// Mean difference of the hinge angles, rad.
    pub(crate) angle: f64,
    /// Largest difference of any coordinate, m or rad.
    pub(crate) largest: f64,
}

/// MuJoCo's recorded traces.
pub(crate) struct Traces(Value);

impl Traces {
    pub(crate) fn read() -> Self {
        let text = include_str!("../../tests/data/mujoco-traces.json");
        Self(serde_json::from_str(text).expect("the recorded traces are JSON"))
    }

    pub(crate) fn source(&self) -> &str {
        self.0["source"].as_str().expect("the traces name their source")
    }

    pub(crate) fn times_secs(&self) -> Vec<f64> {
        numbers(&self.0["times_secs"])
    }

    /// Differences in free flight at the recorded times, with every physics step split into `parts`.
    pub(crate) fn flight(&self, (name, task): (&str, &str), parts: u32) -> Vec<Difference> {
        const HIGH: f64 = 8.0;
        let episode = &self.0["robots"][name]["flight"];
        let robot = Arc::new(Robot::of_task(task).expect("the task is known"));
        let height = height(&robot);
        let mut start = numbers(&episode["start"]);
        start[height] += HIGH;
        let mut seen = self.play(&robot, &start, &episode["controls"], parts);
        seen.iter_mut().for_each(|at| at[height] -= HIGH);
        differences(&robot, &seen, &episode["exact"])
    }

    /// Mean differences on the ground over all sequences: between ours and MuJoCo's at the task's step, and between
    /// MuJoCo's and its own at a quarter of that step.
    pub(crate) fn ground(&self, (name, task): (&str, &str), drive: &str) -> [Vec<Difference>; 2] {
        let robot = Arc::new(Robot::of_task(task).expect("the task is known"));
        let episodes = self.0["robots"][name][drive].as_array().expect("a list of sequences");
        let (mut ours, mut own) = (Vec::new(), Vec::new());
        for episode in episodes {
            let seen = self.play(&robot, &numbers(&episode["start"]), &episode["controls"], 1);
            ours.push(differences(&robot, &seen, &episode["task_step"]));
            let coarse = episode["task_step"].as_array().expect("a list of times");
            let coarse: Vec<Vec<f64>> = coarse.iter().map(numbers).collect();
            own.push(differences(&robot, &coarse, &episode["quarter_step"]));
        }
        [mean(&ours), mean(&own)]
    }

    /// The model's own coordinates at the recorded times.
    fn play(
        &self,
        robot: &Arc<Robot>,
        start: &[f64],
        controls: &Value,
        parts: u32,
    ) -> Vec<Vec<f64>> {
        let mut world = World::refined(Arc::clone(robot), parts);
        let reference = robot.reference();
        let start: Vec<f32> = start.iter().zip(reference).map(|(q, r)| *q as f32 - r).collect();
        world.rebuild(&start, &vec![0.0; robot.velocity_names().len()]);
        let hold_secs = self.0["hold_secs"].as_f64().expect("a number");
        let steps = (hold_secs / robot.physics_step_secs()).round() as u32 * parts;
        let times = self.times_secs();
        let mut seen = Vec::new();
        for (segment, row) in controls.as_array().expect("a list of controls").iter().enumerate() {
            world.command(&numbers(row).iter().map(|c| *c as f32).collect::<Vec<f32>>());
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

/// Index of the root's height in the coordinates.
fn height(robot: &Robot) -> usize {
    let names = robot.coordinate_names();
    names.iter().position(|name| name == "rootz" || name == "root.z").expect("a root has a height")
}

fn differences(robot: &Robot, seen: &[Vec<f64>], expected: &Value) -> Vec<Difference> {
    let expected = expected.as_array().expect("a list of times").iter().map(numbers);
    let hinges = robot.hinges().count();
    let at = |(got, expected): (&Vec<f64>, Vec<f64>)| {
        let off: Vec<f64> = got.iter().zip(expected).map(|(g, e)| (g - e).abs()).collect();
        let angles = &off[off.len() - hinges..];
        Difference {
            place: off[0],
            angle: angles.iter().sum::<f64>() / hinges as f64,
            largest: off.iter().copied().fold(0.0, f64::max),
        }
    };
    seen.iter().zip(expected).map(at).collect()
}

fn mean(sequences: &[Vec<Difference>]) -> Vec<Difference> {
    let count = sequences.len() as f64;
    let of = |moment: usize, part: fn(&Difference) -> f64| {
        sequences.iter().map(|sequence| part(&sequence[moment])).sum::<f64>() / count
    };
    let at = |moment| Difference {
        place: of(moment, |d| d.place),
        angle: of(moment, |d| d.angle),
        largest: of(moment, |d| d.largest),
    };
    (0..sequences[0].len()).map(at).collect()
}

/// A list of numbers.
pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().expect("a list of numbers");
    list.iter().map(|number| number.as_f64().expect("a number")).collect()
}
