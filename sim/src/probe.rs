//! The simulator's part of the numeric fingerprint. Programs with equal probes produce equal episodes.

use std::collections::BTreeSet;

use proto::ActionSpec;

use crate::config::{
    ContactForces, ObservationConfig, ObservationMode, ObservationNorm, RootView, TaskConfig,
    TaskDefinition,
};
use crate::environment_batch::environments;
use crate::environment_batch::{EnvironmentBatch, Outcome};
use crate::task::task_names;

/// Falling hulls, ellipsoids and balls on a height field, which none of the program's tasks has.
const SHAPES: [&str; 2] = [
    "robot = \"shapes\"\nmodel = \"shapes.xml\"\nframe_skip = 5\nepisode_steps = 100\n\
     [agents]\n1x1 = [[\"arm\"]]\n",
    r#"<mujoco><option timestep="0.005"/><asset><mesh name="hull" vertex="-0.1 -0.1 0 0.1 -0.1 0 0 0.15 0 0 0 0.15"/>
    <hfield name="field" nrow="3" ncol="3" size="1 1 0.1 0.1" elevation="0 1 0 2 0 1 0 1 2"/></asset><worldbody>
    <geom type="hfield" hfield="field"/>
    <body name="arm" pos="0.5 -0.5 0.3"><joint name="arm" axis="0 1 0"/>
    <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/></body>
    <body name="hull" pos="0.2 0.1 0.14"><freejoint name="hull"/><geom type="mesh" mesh="hull"/></body>
    <body name="egg" pos="-0.5 -0.5 0.25"><freejoint name="egg"/><geom type="ellipsoid" size="0.15 0.12 0.1"/></body>
    <body name="ball" pos="-0.46 -0.5 0.42"><freejoint name="ball"/><geom size="0.05"/></body>
    </worldbody><actuator><motor joint="arm" ctrlrange="-1 1"/></actuator></mujoco>"#,
];
/// Steps with each robot: long enough for contacts.
const STEPS: u32 = 24;
/// Steps with a robot's further tasks and observations, whose physics is that of its first.
const FURTHER_STEPS: u32 = 4;

/// Start states, observations, global states, rewards and ends of two episodes of every task, and of two that files
/// define, with every kind of observation, under fixed actions. Little-endian f32. Every process of a run computes it
/// when it starts.
pub fn probe() -> Vec<u8> {
    let tasks = task_names().iter().map(|task| (*task, None));
    let [file, model] = SHAPES.map(str::to_owned);
    let shapes = TaskDefinition { file, model };
    let tasks = tasks
        .chain([("hopper-2x1", Some(TaskDefinition::example())), ("shapes-1x1", Some(shapes))]);
    let mut numbers = Vec::new();
    let mut stepped = BTreeSet::new();
    for (task, definition) in tasks {
        let (robot, _) = task.rsplit_once('-').expect("tasks are named robot-agents");
        let mut steps = if stepped.insert(robot) { STEPS } else { FURTHER_STEPS };
        for view in views() {
            if let Some((trace, _)) = trace(task, definition.clone(), view, steps) {
                numbers.extend(trace);
                steps = FURTHER_STEPS;
            }
        }
    }
    numbers.into_iter().flat_map(f32::to_le_bytes).collect()
}

/// The only observation that games have; one of everything, scaled; and one of the neighbourhood.
fn views() -> [ObservationConfig; 3] {
    let view = |mode, norm, contact_forces| ObservationConfig {
        mode,
        norm,
        nearest: 1,
        globals: RootView::Shown,
        contact_forces,
    };
    [
        view(ObservationMode::FullId, ObservationNorm::None, ContactForces::Absent),
        view(ObservationMode::FullId, ObservationNorm::FeatureZ, ContactForces::Zeros),
        view(ObservationMode::KNearest, ObservationNorm::None, ContactForces::Zeros),
    ]
}

/// The numbers and the environments after the last step; `None` if the task has no such observation. The second
/// episode ends halfway.
fn trace(
    task: &str,
    definition: Option<TaskDefinition>,
    observation: ObservationConfig,
    steps: u32,
) -> Option<(Vec<f32>, Box<dyn EnvironmentBatch>)> {
    let task = task.to_owned();
    let config = TaskConfig { task, definition, weights: None, observation };
    let mut environments = environments(&config, 2).ok()?;
    let mut numbers = Vec::new();
    for (environment, limit) in [(0, u32::MAX), (1, steps / 2)] {
        environments.reset(environment, 0, limit, [7; 32]).expect("the simulator's own tasks");
    }
    let mut outcome = [Outcome::default(); 2];
    record(&*environments, &outcome, &mut numbers);
    for step in 0..steps {
        let actions = actions(&*environments, step as usize);
        environments.step(&actions, &mut outcome).expect("the actions are in range");
        record(&*environments, &outcome, &mut numbers);
    }
    Some((numbers, environments))
}

/// A triangle wave, which is exact in f32 and needs no library function; for choices, each in turn. Carts drive straight on:
/// only so do they push their load in this time.
fn actions(environments: &dyn EnvironmentBatch, step: usize) -> Vec<f32> {
    let drives_on = environments.description().task.starts_with("carry");
    let ranges = environments.description().agents.iter().map(|agent| &agent.action);
    let ranges = ranges.flat_map(|range| std::iter::repeat_n(range, range.size));
    let action = |(index, range): (usize, &ActionSpec)| match range.choices {
        Some(choices) => ((step + index) % choices as usize) as f32,
        None if drives_on => range.high,
        None => {
            let phase = ((3 * step + 5 * index) % 32) as f32 / 16.0;
            range.low + (range.high - range.low) * (phase - 1.0).abs()
        }
    };
    let one: Vec<f32> = ranges.enumerate().map(action).collect();
    one.repeat(environments.count())
}

fn record(environments: &dyn EnvironmentBatch, outcome: &[Outcome; 2], numbers: &mut Vec<f32>) {
    for (environment, outcome) in outcome.iter().enumerate() {
        let flags = [outcome.terminated, outcome.truncated, outcome.fault];
        numbers.push(outcome.reward);
        numbers.extend(flags.map(f32::from));
        numbers.extend(environments.observations_of(environment).concat());
        numbers.extend(environments.state_of(environment));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The global state after the last step has these features.
    fn last(task: &str, definition: Option<TaskDefinition>, names: [&str; 3]) -> [f32; 3] {
        let [view, ..] = views();
        let (_, environments) = trace(task, definition, view, STEPS).unwrap();
        let state = environments.state_of(0);
        let features = &environments.description().state;
        names.map(|name| state[features.iter().position(|own| own.name == name).expect(name)])
    }

    #[test]
    fn the_carts_push_their_load() {
        for task in ["carry-light-2x2", "carry-heavy-2x2"] {
            let names = ["left.x.velocity", "right.x.velocity", "load.x.velocity"];
            let speeds = last(task, None, names);
            assert!(speeds.iter().all(|speed| *speed > 0.02), "{task}: {speeds:?}");
        }
    }

    #[test]
    fn the_shapes_rest_on_the_height_field_and_the_ball_slides_off_the_ellipsoid() {
        let [file, model] = SHAPES.map(str::to_owned);
        let names = ["hull.z.position", "egg.z.position", "ball.x.position"];
        let [hull, egg, ball] = last("shapes-1x1", Some(TaskDefinition { file, model }), names);
        // In 0.6 s, each would fall by 1.8 m.
        assert!((-0.1..0.14).contains(&hull) && (0.0..0.25).contains(&egg), "{hull} {egg}");
        assert!(ball > -0.45, "{ball}");
    }
}
