//! What each setting needs for an effect in a run.

use std::fmt;

use Condition::{Above0, Environment, Filled, Is, Not, Zero};
use Property::{Contacts, Continuous, Robot, Several};

/// What a setting needs for an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Condition {
    /// This setting has one of these values.
    Is(&'static str, &'static [&'static str]),
    /// This setting has another value.
    Not(&'static str, &'static str),
    /// This number is above 0.
    Above0(&'static str),
    /// This number is 0.
    Zero(&'static str),
    /// This text is not empty.
    Filled(&'static str),
    /// The environment is such.
    Environment(Property),
}

/// A property of the run's environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Property {
    /// A robot of the simulator.
    Robot,
    /// A robot whose task supports contact forces.
    Contacts,
    /// Agents with continuous actions.
    Continuous,
    /// Several agents.
    Several,
}

impl Condition {
    /// The setting on whose value it depends; `None` if it depends on the environment.
    pub(super) fn setting(self) -> Option<&'static str> {
        match self {
            Self::Is(key, _)
            | Self::Not(key, _)
            | Self::Above0(key)
            | Self::Zero(key)
            | Self::Filled(key) => Some(key),
            Self::Environment(_) => None,
        }
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Is("update.rule", ["maddpg"]) => f.write_str("algorithm = maddpg"),
            Self::Is(key, values) => write!(f, "{key} = {}", values.join(" or ")),
            Self::Not(key, value) => write!(f, "another {key} than {value}"),
            Self::Above0(key) => write!(f, "{key} above 0"),
            Self::Zero(key) => write!(f, "{key} = 0"),
            Self::Filled(key) => write!(f, "{key}"),
            Self::Environment(property) => f.write_str(match property {
                Property::Robot => "a robot of the simulator",
                Property::Contacts => "a robot whose task supports contact forces, such as ant-4x2",
                Property::Continuous => "continuous actions",
                Property::Several => "several agents",
            }),
        }
    }
}

/// Rules that update policies from the newest rollout only.
const ON_POLICY: Condition = Is("update.rule", &["happo", "mappo"]);
const MADDPG: Condition = Is("update.rule", &["maddpg"]);
const GRU: Condition = Is("policy.core", &["gru"]);
const MLP: Condition = Is("policy.core", &["mlp"]);
const SURPRISE: Condition = Above0("surprise.alpha");
const INFLUENCE: Condition = Above0("influence.lambda");
/// The estimator with a posterior that is trained.
const LEARNT: Condition = Is("influence.estimator", &["variational_kl"]);
const MLE: Condition = Is("influence.q_training", &["mle"]);

/// The conditions of one alternative must all hold, and one alternative is enough.
type Alternatives = &'static [&'static [Condition]];

/// Every setting that can be without an effect.
pub(super) const TABLE: &[(&[&str], Alternatives)] = &[
    (&["run.env_steps"], &[&[Zero("run.iterations")]]),
    (&["task_file.text"], &[&[Filled("task_file.model")]]),
    (&["task_file.model"], &[&[Filled("task_file.text")]]),
    (&["environment_service.description"], &[&[Filled("environment_service.url")]]),
    (&["observation.mode"], &[&[Environment(Robot)]]),
    (
        &["observation.nearest", "observation.globals"],
        &[&[Environment(Robot), Is("observation.mode", &["k_nearest"])]],
    ),
    (&["observation.contact_forces"], &[&[Environment(Contacts)]]),
    (&["policy.encoder", "policy.hidden"], &[&[GRU]]),
    (&["policy.width", "policy.layers"], &[&[MLP]]),
    (&["policy.sigma_scale", "policy.sigma_floor"], &[&[ON_POLICY, Environment(Continuous)]]),
    (&["update.parameters"], &[&[Environment(Several)]]),
    (
        &[
            "update.gae_lambda",
            "update.clip",
            "update.epochs",
            "update.minibatches",
            "update.entropy",
            "update.desired_kl",
            "critic.input_norm",
            "critic.epochs",
            "critic.minibatches",
            "critic.clip",
            "critic.huber_delta",
            "critic.normalizer_beta",
        ],
        &[&[ON_POLICY]],
    ),
    (&["surprise.density"], &[&[SURPRISE]]),
    (&["influence.lambda"], &[&[Environment(Several)]]),
    (
        &["influence.estimator", "influence.q_training", "influence.lag", "influence.kappa"],
        &[&[INFLUENCE, Environment(Several)]],
    ),
    (&["influence.encoder", "influence.hidden"], &[&[INFLUENCE, LEARNT, Environment(Several)]]),
    (
        &["influence.posterior_sigma_floor"],
        &[&[INFLUENCE, LEARNT, Environment(Several), Environment(Continuous)]],
    ),
    (
        &[
            "influence.epochs",
            "influence.learning_rate",
            "influence.minibatches",
            "influence.holdout_every",
        ],
        &[&[INFLUENCE, LEARNT, MLE, Environment(Several)]],
    ),
    (
        &[
            "maddpg.replay",
            "maddpg.batch",
            "maddpg.n_step",
            "maddpg.warm_up",
            "maddpg.updates_per_step",
            "maddpg.noise",
            "maddpg.polyak",
        ],
        &[&[MADDPG]],
    ),
    (&["evaluation.episodes", "evaluation.sampled"], &[&[Above0("evaluation.every_steps")]]),
    (&["log.max_file_mib"], &[&[Not("log.episodes", "none")]]),
];
