//! Messages leave out the observations that the learner restores, for every robot task and setting of observations.

use std::ops::ControlFlow;

use proto::{TrajectoryChunk, wire};
use sim::{
    ContactForces, ObservationConfig, ObservationMode, ObservationNorm, Robot, RootView, TaskConfig,
};

use crate::fixture::{ENVIRONMENTS, policy_for, task};
use crate::work::{fresh_work, run_of};

/// The message of each chunk of a rolled-out slot, after a check that the learner reads the chunk from it.
fn messages(task: &TaskConfig) -> Vec<wire::TrajectoryChunk> {
    let mut world = sim::environments(task, ENVIRONMENTS).unwrap();
    let (run, work, policy) = (run_of(task), fresh_work(), policy_for(world.description()));
    let mut messages = Vec::new();
    let emit = |chunk: TrajectoryChunk| {
        let (message, digest) = chunk.to_wire(&run, &work.origin());
        let read = TrajectoryChunk::from_wire(&message, &run, &work.origin(), digest);
        assert_eq!(bits(&read.unwrap()), bits(&chunk), "{task:?}");
        messages.push(message);
        ControlFlow::Continue(())
    };
    rollout::roll_out(&run, &work, &policy, world.as_mut(), |_| {}, emit).unwrap();
    messages
}

/// All observations, in which 0 and -0 differ.
fn bits(chunk: &TrajectoryChunk) -> Vec<u32> {
    let rows = chunk.agents.iter().map(|agent| &agent.observation);
    let finals = chunk.finals.iter().flat_map(|last| &last.observation);
    rows.chain(finals).flatten().map(|number| number.to_bits()).collect()
}

/// For each agent, whether any of the messages has its observations.
fn sent(messages: &[wire::TrajectoryChunk]) -> Vec<bool> {
    let has = |tensor: Option<&wire::Tensor>| tensor.is_some_and(|tensor| !tensor.data.is_empty());
    let sends = |message: &wire::TrajectoryChunk, agent: usize| {
        let finals = message.finals.as_ref().unwrap();
        has(message.agents[agent].observation.as_ref()) || has(finals.observations.get(agent))
    };
    let agents = 0..messages[0].agents.len();
    agents.map(|agent| messages.iter().any(|message| sends(message, agent))).collect()
}

fn settings() -> Vec<ObservationConfig> {
    let norms = [ObservationNorm::None, ObservationNorm::Running, ObservationNorm::FeatureZ];
    let forces = [ContactForces::Absent, ContactForces::Zeros];
    let views = [
        (ObservationMode::FullId, RootView::Shown),
        (ObservationMode::KNearest, RootView::Shown),
        (ObservationMode::KNearest, RootView::Hidden),
    ];
    let mut settings = Vec::new();
    for norm in norms {
        for contact_forces in forces {
            settings.extend(views.map(|(mode, globals)| ObservationConfig {
                mode,
                norm,
                nearest: 1,
                globals,
                contact_forces,
            }));
        }
    }
    settings
}

#[test]
fn every_setting_of_every_robot_task_sends_only_observations_that_are_no_copies() {
    for name in sim::task_names().iter().copied().filter(|name| Robot::of_task(name).is_ok()) {
        for observation in settings() {
            let ObservationConfig { mode, norm, .. } = observation;
            let task = TaskConfig { task: name.to_owned(), observation, ..task() };
            let sent = sent(&messages(&task));
            let expected = (0..sent.len()).map(|agent| match (norm, mode) {
                (ObservationNorm::None | ObservationNorm::Running, _) => false,
                // Another agent's identity only exchanges two features.
                (ObservationNorm::FeatureZ, ObservationMode::FullId) => agent == 0,
                (ObservationNorm::FeatureZ, ObservationMode::KNearest) => true,
            });
            assert_eq!(sent, expected.collect::<Vec<_>>(), "{task:?}");
        }
    }
}
