//! Environment steps per second on one core, for each robot, compared with MuJoCo on the same core in the same run.
//!
//! `cargo bench -p sim` prints our rates for the robots of the program, `cargo bench -p sim -- robot.toml` for those of task
//! files. With `MUJOCO_PYTHON=venv/bin/python`, an interpreter with `mujoco` and `gymnasium`, it also times MuJoCo's C step
//! between our measurements and prints the ratio of the medians. Controls are uniform in their ranges (`random`), or in the
//! middle of them (`still`). An episode that ends early is shorter here only, so the task file should end none.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use rand::RngCore;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use sim::{Outcome, TaskConfig, TaskDefinition};

/// Task of each robot, its model in Gymnasium, and its physics steps in an environment step.
const ROBOTS: [(&str, &str, i64); 3] = [
    ("halfcheetah-6x1", "half_cheetah", 5),
    ("walker2d-2x3", "walker2d", 4),
    ("ant-4x2", "ant", 5),
];
const REPEATS: usize = 7;
const STEPS: usize = 3_000;
/// Controls, and their part of the ranges.
const CONTROLS: [(&str, f32); 2] = [("random", 1.0), ("still", 0.0)];

/// A robot here and in MuJoCo.
struct Case {
    task: String,
    definition: Option<TaskDefinition>,
    /// A file, or a name in Gymnasium.
    model: PathBuf,
    frame_skip: i64,
}

fn main() {
    let python = std::env::var("MUJOCO_PYTHON").ok();
    let files: Vec<_> = std::env::args().filter(|argument| argument.ends_with(".toml")).collect();
    let cases: Vec<Case> = match files.as_slice() {
        [] => ROBOTS.map(Case::shipped).into(),
        files => files.iter().map(|file| Case::of_file(Path::new(file))).collect(),
    };
    println!("environment steps per second on one core, median of {REPEATS} runs of {STEPS} steps");
    println!("{:<16} {:<8} {:>10} {:>10} {:>8}", "robot", "controls", "ours", "MuJoCo", "ratio");
    for case in cases {
        for (controls, width) in CONTROLS {
            let (mut ours, mut theirs) = (Vec::new(), Vec::new());
            for _ in 0..REPEATS {
                ours.push(case.our_rate(width));
                theirs.extend(python.as_deref().and_then(|it| case.mujoco_rate(it, controls)));
            }
            let ours = median(ours);
            print!("{:<16} {controls:<8} {ours:>10.0}", case.task);
            if theirs.is_empty() {
                println!(" {:>10} {:>8}", "-", "-");
            } else {
                let theirs = median(theirs);
                println!(" {theirs:>10.0} {:>8.2}", ours / theirs);
            }
        }
    }
}

impl Case {
    fn shipped((task, model, frame_skip): (&str, &str, i64)) -> Self {
        Self { task: task.to_owned(), definition: None, model: model.into(), frame_skip }
    }

    /// The first task of a file.
    fn of_file(path: &Path) -> Self {
        let folder = path.parent().unwrap_or(Path::new(""));
        let file = std::fs::read_to_string(path).expect("the task file can be read");
        let model = TaskDefinition::model_of(&file).expect("the task file is valid");
        let read = |path: &str| std::fs::read(folder.join(path)).map_err(|error| error.to_string());
        let document = sim::one_document(&model, read).expect("the model can be built");
        let table: toml::Table = file.parse().expect("the task file is TOML");
        let definition = TaskDefinition { file, model: document };
        let tasks = definition.task_names().expect("the task file is valid");
        Self {
            task: tasks[0].clone(),
            definition: Some(definition),
            model: folder.join(model),
            frame_skip: table["frame_skip"].as_integer().expect("it is an integer"),
        }
    }

    /// Steps per second under uniform random actions of at most `width`, resets included.
    fn our_rate(&self, width: f32) -> f64 {
        let config: TaskConfig = serde_json::from_value(serde_json::json!({
            "task": self.task,
            "definition": self.definition,
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
                *action = width * ((rng.next_u32() >> 8) as f32 / 8_388_608.0 - 1.0);
            }
            world.step(&actions, &mut outcome).expect("the actions are finite");
            if outcome[0].terminated || outcome[0].truncated {
                world.reset(0, 0, 1000, [0; 32]).expect("the simulator resets");
            }
        }
        STEPS as f64 / start.elapsed().as_secs_f64()
    }

    /// Rate that `mujoco_rate.py` prints.
    fn mujoco_rate(&self, python: &str, controls: &str) -> Option<f64> {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/mujoco_rate.py");
        let [skip, steps] = [self.frame_skip.to_string(), STEPS.to_string()];
        let mut command = Command::new(python);
        let output = command.arg(script).arg(&self.model).args([&skip, &steps, controls]).output();
        String::from_utf8(output.ok()?.stdout).ok()?.trim().parse().ok()
    }
}

fn median(mut rates: Vec<f64>) -> f64 {
    rates.sort_by(f64::total_cmp);
    rates[rates.len() / 2]
}
