//! The paper's learning algorithm: densities, mutual information, advantages, surrogates, critics and learning rules.
//!
//! The learner calls, once per iteration: [`Surprise::refit`], which fits the densities on `D_k` (Eq. 2);
//! [`Surprise::relabel`], which adds the surprise to the team reward (Eq. 9); [`Algorithm::update`], which updates the
//! policies on the relabelled batch (Eq. 10), or on earlier steps that it relabels with the same densities. This crate reads
//! no file, clock or socket. No result depends on the number of threads.

pub mod config;
pub mod critic;
mod data;
mod density;
pub mod distribution;
pub mod error;
pub mod influence;
pub mod objective;
mod optimisation;
mod rounding;
mod rules;
mod shape;
pub mod state;
mod surprise;

pub use config::{
    CriticConfig, HasacConfig, InfluenceConfig, MaddpgConfig, ReplaySettings, SurpriseConfig,
    TrainingConfig, UpdateConfig,
};
pub use data::batch::{ActionKind, AgentBatch, AgentShape, Batch, Final, Problem, Rewards};
pub use data::observation::{ObservationMoments, ObservationScale};
pub use error::MarlError;
pub use optimisation::learning_rate::LearningRateDecay;
pub use rules::algorithm::{Algorithm, Report};
pub use rules::build;
pub use rules::start::start_from;
pub use state::StoredState;
pub use surprise::{Relabelled, Surprise};

#[cfg(test)]
extern crate self as marl;

#[cfg(test)]
#[path = "../tests/fixture/base.rs"]
mod base;

#[cfg(test)]
#[path = "../tests/fixture/sample.rs"]
mod sample;
