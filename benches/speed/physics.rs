//! Environment steps of one robot on one core, resets included.

use policy::randomness::{Draw, DrawKey, Purpose, RunSeed, uniform};
use sim::Outcome;

use crate::Effort;
use crate::clock::typical;
use crate::settings::CaseSettings;
use crate::table::CaseRow;

const TASKS: [&str; 3] = ["halfcheetah-2x3", "walker2d-2x3", "ant-4x2"];
const STEPS: usize = 2_000;
const EPISODE_STEPS: u32 = 1_000;

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    TASKS.into_iter().map(|task| row(task, effort)).collect()
}

fn row(task: &str, effort: Effort) -> anyhow::Result<CaseRow> {
    let mut world = CaseSettings::of(&[task])?.world(1)?;
    let width = world.description().agents.iter().map(|agent| agent.action.size).sum();
    let key = DrawKey::of(RunSeed(7), Draw::of(Purpose::Probe));
    let mut rng = key.generator();
    let actions: Vec<f32> = (0..STEPS * width).map(|_| 2.0 * uniform(&mut rng) - 1.0).collect();
    let took = typical(effort.repeats, || {
        let mut outcome = [Outcome::default()];
        world.reset(0, 0, EPISODE_STEPS, key.0).expect("the simulator resets");
        for action in actions.chunks_exact(width) {
            world.step(action, &mut outcome).expect("the actions are finite");
            if outcome[0].terminated || outcome[0].truncated {
                world.reset(0, 0, EPISODE_STEPS, key.0).expect("the simulator resets");
            }
        }
    });
    let steps = STEPS as f64;
    let figures = vec![
        ("env steps per processor s", steps / took.thread),
        ("env steps/s by the wall clock", steps / took.wall),
    ];
    Ok(CaseRow { case: task.to_owned(), figures })
}
