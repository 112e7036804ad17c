//! Episodes under uniform random actions, with the same starts and actions as MuJoCo's statistics.

use std::sync::Arc;

use serde_json::Value;
use sim::{Robot, World};

/// Means over all steps of all episodes, except the quantile and the episode length.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Statistics {
    /// The root's height in the model's coordinates, m.
    pub(crate) height: f64,
    /// Fraction of steps that end with a contact force.
    pub(crate) contact: f64,
    /// 99.9 % quantile of the violation of a hinge's limit, rad.
    pub(crate) overshoot: f64,
    /// Mean speed of the hinges, rad/s.
    pub(crate) joint_speed: f64,
    /// Episode length, steps.
    pub(crate) length: f64,
}

impl Statistics {
    /// Reads MuJoCo's recorded statistics.
    pub(crate) fn recorded(value: &Value) -> Self {
        let number = |name: &str| value[name].as_f64().expect("a number");
        Self {
            height: number("height"),
            contact: number("contact"),
            overshoot: number("overshoot"),
            joint_speed: number("joint_speed"),
            length: number("length"),
        }
    }
}

/// Plays the same episodes in this simulator.
pub(crate) fn play((name, task): (&str, &str), record: &Value) -> Statistics {
    let robot = Arc::new(Robot::of_task(task).expect("the task is known"));
    let whole = |name: &str| record[name].as_u64().expect("a whole number");
    let mut sums = Sums::default();
    for episode in 0..whole("episodes") {
        let noise = record["noise"].as_f64().expect("a number");
        let mut world = started(name, &robot, episode, noise);
        sums.lengths += episode_length(name, &mut world, episode, whole("longest"), &mut sums);
    }
    sums.statistics(whole("episodes") as f64)
}

#[derive(Default)]
struct Sums {
    steps: f64,
    height: f64,
    contact: f64,
    speed: f64,
    lengths: f64,
    overshoots: Vec<f64>,
}

impl Sums {
    fn add(&mut self, world: &World, motion: &[f32], height: f32) {
        let robot = world.robot();
        let hinges = robot.hinges().count();
        let speeds = motion[motion.len() - hinges..].iter().map(|speed| f64::from(speed.abs()));
        self.steps += 1.0;
        self.height += f64::from(height);
        self.contact += f64::from(u8::from(world.contact_impulse() > 0.0));
        self.speed += speeds.sum::<f64>() / hinges as f64;
    }

    fn add_overshoots(&mut self, robot: &Robot, at: &[f32]) {
        let angles = &at[at.len() - robot.hinges().count()..];
        for ((_, range), angle) in robot.hinges().zip(angles) {
            let [low, high] = range.expect("all hinges are limited");
            self.overshoots.push(f64::from((low - angle).max(angle - high).max(0.0)));
        }
    }

    fn statistics(mut self, episodes: f64) -> Statistics {
        self.overshoots.sort_by(f64::total_cmp);
        let index = (0.999 * (self.overshoots.len() - 1) as f64) as usize;
        Statistics {
            height: self.height / self.steps,
            contact: self.contact / self.steps,
            overshoot: self.overshoots[index],
            joint_speed: self.speed / self.steps,
            length: self.lengths / episodes,
        }
    }
}

fn started(name: &str, robot: &Arc<Robot>, episode: u64, noise: f64) -> World {
    let mut at = robot.rest().to_vec();
    for (index, number) in at.iter_mut().enumerate() {
        *number += (noise * draw(episode, 0, index as u64)) as f32;
    }
    if name == "ant" {
        let length = at[3..7].iter().map(|q| q * q).sum::<f32>().sqrt();
        at[3..7].iter_mut().for_each(|q| *q /= length);
    }
    let index = 0..robot.velocity_names().len() as u64;
    let motion: Vec<f32> = index.map(|k| (noise * draw(episode, 0, 64 + k)) as f32).collect();
    let mut world = World::new(Arc::clone(robot));
    world.rebuild(&at, &motion);
    world
}

fn episode_length(
    name: &str,
    world: &mut World,
    episode: u64,
    longest: u64,
    sums: &mut Sums,
) -> f64 {
    let motors = world.robot().actuators().count() as u64;
    let place = if name == "ant" { 2 } else { 1 };
    let reference = world.robot().reference().to_vec();
    let mut at = vec![0.0; reference.len()];
    let mut motion = vec![0.0; world.robot().velocity_names().len()];
    for step in 1..=longest {
        let controls: Vec<f32> = (0..motors).map(|k| draw(episode, step, k) as f32).collect();
        assert!(world.step(&controls), "the state is finite");
        world.coordinates(&mut at);
        world.velocities(&mut motion);
        let height = at[place] + reference[place];
        sums.add(world, &motion, height);
        // Ant starts with its ankles outside their limits.
        if step > 20 || name != "ant" {
            sums.add_overshoots(world.robot(), &at);
        }
        let fallen = match name {
            "walker2d" => !(0.8 < height && height < 2.0 && at[2].abs() < 1.0),
            "ant" => !(0.2..=1.0).contains(&height),
            _ => false,
        };
        if fallen {
            return step as f64;
        }
    }
    longest as f64
}

/// Draws uniformly from [-1, 1) with 24 bits, as the script that recorded MuJoCo's statistics does.
fn draw(episode: u64, step: u64, index: u64) -> f64 {
    (mixed((episode << 32) + (step << 8) + index) >> 40) as f64 / 8_388_608.0 - 1.0
}

/// The finaliser of splitmix64.
fn mixed(word: u64) -> u64 {
    let word = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ (word >> 31)
}
