//! What a fuzz target and the inputs that it begins with must agree on.

use sim::{
    ContactForces, EnvironmentBatch, ObservationConfig, ObservationMode, ObservationNorm,
    PartitionSemantics, RootView, TaskConfig,
};

/// A robot of each kind, one of them with contact forces in its state, and the game; an input of `environment_state`
/// names one by its place here.
pub const TASKS: [(&str, ContactForces); 5] = [
    ("halfcheetah-2x3", ContactForces::Absent),
    ("walker2d-2x3", ContactForces::Absent),
    ("ant-2x4", ContactForces::Absent),
    ("ant-2x4", ContactForces::Real),
    ("cue-2x1", ContactForces::Absent),
];

/// One world of an entry of [`TASKS`].
///
/// # Panics
/// If the task is not known.
#[must_use]
pub fn world((task, contact_forces): (&str, ContactForces)) -> Box<dyn EnvironmentBatch> {
    let config = TaskConfig {
        task: task.to_owned(),
        definition: None,
        observation: ObservationConfig {
            mode: ObservationMode::FullId,
            norm: ObservationNorm::None,
            nearest: 0,
            globals: RootView::Shown,
            contact_forces,
        },
        partition: PartitionSemantics::ActuatorSlices,
    };
    sim::environments(&config, 1).expect("a known task")
}
