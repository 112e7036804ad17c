//! The simulator's part of the numeric fingerprint. Programs with equal probes produce equal episodes.

use proto::ActionSpec;

use crate::config::{
    ContactForces, ObservationConfig, ObservationMode, ObservationNorm, RootView, TaskConfig,
    TaskDefinition,
};
use crate::environment_batch::environments;
use crate::environment_batch::{EnvironmentBatch, Outcome};
use crate::task::task_names;

/// Steps with each task and scaling: long enough for contacts.
const STEPS: usize = 24;
/// Ends one of the two episodes before the last step.
const LIMIT: u32 = 15;

/// Start states, observations, global states, rewards and ends of two episodes of every task, and of one that files
/// define, with every kind of observation, under fixed actions. Little-endian f32.
pub fn probe() -> Vec<u8> {
    let tasks = task_names().iter().map(|task| (*task, None));
    let tasks = tasks.chain([("hopper-2x1", Some(TaskDefinition::example()))]);
    let traces = tasks
        .flat_map(|(task, definition)| views().map(|view| trace(task, definition.clone(), view)));
    traces.flatten().flatten().collect()
}

/// An observation of everything, scaled; one of the neighbourhood; and the only one that games have.
fn views() -> [ObservationConfig; 3] {
    let view = |mode, norm, contact_forces| ObservationConfig {
        mode,
        norm,
        nearest: 1,
        globals: RootView::Shown,
        contact_forces,
    };
    [
        view(ObservationMode::FullId, ObservationNorm::FeatureZ, ContactForces::Zeros),
        view(ObservationMode::KNearest, ObservationNorm::None, ContactForces::Zeros),
        view(ObservationMode::FullId, ObservationNorm::None, ContactForces::Absent),
    ]
}

/// `None` if the task has no such observation.
fn trace(
    task: &str,
    definition: Option<TaskDefinition>,
    observation: ObservationConfig,
) -> Option<Vec<u8>> {
    let task = task.to_owned();
    let config = TaskConfig { task, definition, weights: None, observation };
    let mut environments = environments(&config, 2).ok()?;
    let mut numbers = Vec::new();
    for (environment, limit) in [(0, u32::MAX), (1, LIMIT)] {
        environments.reset(environment, 0, limit, [7; 32]).expect("the simulator's own tasks");
    }
    let mut outcome = [Outcome::default(); 2];
    record(&*environments, &outcome, &mut numbers);
    for step in 0..STEPS {
        let actions = actions(&*environments, step);
        environments.step(&actions, &mut outcome).expect("the actions are in range");
        record(&*environments, &outcome, &mut numbers);
    }
    Some(numbers.iter().flat_map(|number: &f32| number.to_le_bytes()).collect())
}

/// A triangle wave, which is exact in f32 and needs no library function; for choices, each in turn.
fn actions(environments: &dyn EnvironmentBatch, step: usize) -> Vec<f32> {
    let ranges = environments.description().agents.iter().map(|agent| &agent.action);
    let ranges = ranges.flat_map(|range| std::iter::repeat_n(range, range.size));
    let action = |(index, range): (usize, &ActionSpec)| match range.choices {
        Some(choices) => ((step + index) % choices as usize) as f32,
        None => {
            let phase = ((3 * step + 5 * index) % 32) as f32 / 16.0;
            range.low + (range.high - range.low) * (phase - 1.0).abs()
        }
    };
    let one: Vec<f32> = ranges.enumerate().map(action).collect();
    one.repeat(environments.count())
}

fn record(environments: &dyn EnvironmentBatch, outcome: &[Outcome; 2], numbers: &mut Vec<f32>) {
    let description = environments.description();
    for (environment, outcome) in outcome.iter().enumerate() {
        let flags = [outcome.terminated, outcome.truncated, outcome.fault];
        numbers.push(outcome.reward);
        numbers.extend(flags.map(f32::from));
        for (agent, described) in description.agents.iter().enumerate() {
            let start = numbers.len();
            numbers.resize(start + described.observation.len(), 0.0);
            environments.observation(environment, agent, &mut numbers[start..]);
        }
        let start = numbers.len();
        numbers.resize(start + description.state.len(), 0.0);
        environments.state(environment, &mut numbers[start..]);
    }
}
