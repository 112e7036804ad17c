//! A small real task and policies for it, also for the tests of other crates.

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use policy::{ActorNetwork, CoreKind, Head, PolicyConfig, PolicySnapshot};
use sim::{
    ContactForces, EnvironmentBatch, ObservationConfig, ObservationMode, ObservationNorm, RootView,
    TaskConfig,
};

pub(crate) const ENVIRONMENTS: usize = 2;
pub(crate) const HIDDEN_EVERY: u32 = 10;
pub(crate) const HIDDEN: usize = 8;

pub(crate) fn task() -> TaskConfig {
    TaskConfig {
        task: "halfcheetah-2x3".to_owned(),
        definition: None,
        weights: None,
        observation: ObservationConfig {
            mode: ObservationMode::FullId,
            norm: ObservationNorm::FeatureZ,
            nearest: 1,
            globals: RootView::Hidden,
            contact_forces: ContactForces::Absent,
        },
    }
}

pub(crate) fn world() -> Box<dyn EnvironmentBatch> {
    sim::environments(&task(), ENVIRONMENTS).unwrap()
}

pub(crate) fn policy() -> PolicySnapshot {
    policy_for(world().description())
}

pub(crate) fn policy_for(description: &proto::EnvironmentSpec) -> PolicySnapshot {
    policy_of(&policy_config(), description)
}

pub(crate) fn policy_config() -> PolicyConfig {
    PolicyConfig {
        encoder: 8,
        hidden: HIDDEN,
        width: 8,
        backpropagation_steps: HIDDEN_EVERY as usize,
        ..policy::probe::config(CoreKind::Gru)
    }
}

pub(crate) fn policy_of(
    config: &PolicyConfig,
    description: &proto::EnvironmentSpec,
) -> PolicySnapshot {
    let agent = |(index, shape): (usize, &proto::AgentSpec)| {
        let mut rng = generator(RunSeed(5), Draw::of(Purpose::Initialisation).agent(index as u32));
        let (observation, action) = (shape.observation.len(), shape.action.size);
        let head = match shape.action.choices {
            None => Head::Gaussian,
            Some(choices) => Head::Categorical { choices: choices as usize },
        };
        let head = config.with_noise(head);
        let network = ActorNetwork::new(config, observation, action, head, &mut rng).unwrap();
        network.policy().unwrap()
    };
    PolicySnapshot { agents: description.agents.iter().enumerate().map(agent).collect() }
}
