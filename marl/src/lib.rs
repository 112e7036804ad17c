//! The paper: densities, mutual information, advantages, surrogates, critics, algorithms.
//!
//! One iteration, as the learner calls it: [`Surprise::refit`] fits the densities on `D_k` (Eq. 2),
//! [`Surprise::relabel`] adds the surprise to the team reward (Eq. 9), [`Algorithm::update`] turns
//! the relabelled batch into better policies (Eq. 10). Nothing here reads a file, a clock or a
//! socket, and no result depends on the number of threads.

pub mod algorithm;
pub mod batch;
pub mod config;
pub mod critic;
pub mod density;
pub mod distribution;
pub mod error;
pub mod gradient;
mod happo;
pub mod influence;
mod layers;
pub mod learning_rate;
pub mod maddpg;
mod mappo;
pub mod minibatch;
pub mod objective;
pub mod observation;
mod on_policy;
pub mod optimizer;
pub mod probe;
pub mod reals;
mod rule;
pub mod running;
pub mod sequence;
mod shape;
mod shards;
pub mod surprise;
pub mod value_normalizer;

pub use algorithm::{Algorithm, Report};
pub use batch::{ActionKind, AgentBatch, AgentShape, Batch, Final, Problem, Rewards};
pub use config::{
    Config, CriticConfig, InfluenceConfig, MaddpgConfig, SurpriseConfig, UpdateConfig, VaeConfig,
};
pub use error::MarlError;
pub use learning_rate::LearningRateDecay;
pub use observation::{ObservationMoments, ObservationScale};
pub use probe::probe;
pub use rule::{build, build_in};
pub use surprise::Surprise;
