//! Shared by actors and learner: actor networks, distributions, parameters, weight encoding, all random draws.
//!
//! The learner trains an [`ActorNetwork`] (candle tensors and automatic differentiation, with a network as one
//! operation) and publishes a [`PolicySnapshot`] of it. An actor acts with the [`ActorPolicy`]s of the snapshot,
//! which have no graph. Every random draw of the system comes from [`randomness`].

pub mod acting;
pub mod arrays;
pub mod categorical;
pub mod config;
pub mod error;
pub mod gaussian;
pub mod head;
mod initialise;
pub mod layers;
pub mod network;
pub mod ops;
pub mod parameters;
pub mod probe;
pub mod randomness;
pub mod setting;
pub mod shared_noise;
pub mod snapshot;
pub mod standardisation;
pub mod tanh_gaussian;
mod team;

pub use acting::{ActorPolicy, ActorSpec, Scratch};
pub use arrays::{Array, NamedArrays};
pub use categorical::Categorical;
pub use config::{CoreKind, InputNorm, Noise, PolicyConfig};
pub use error::PolicyError;
pub use gaussian::Gaussian;
pub use head::{Distribution, Head};
pub use network::{ActorNetwork, SequenceInput, project_sigma};
pub use parameters::Parameters;
pub use probe::probe;
pub use randomness::{Draw, DrawKey, Purpose, RunSeed, generator, standard_normal};
pub use setting::SettingError;
pub use shared_noise::SharedNoise;
pub use snapshot::{PolicySnapshot, digest};
pub use standardisation::Standardisation;
pub use team::Team;
