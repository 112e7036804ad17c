//! What actors and the learner must agree on: actor networks, distributions, parameters, weight bytes.
//!
//! The learner trains an [`ActorNetwork`] (candle tensors, automatic differentiation, a network being one
//! operation) and broadcasts a [`PolicySnapshot`] of it; an actor acts with the snapshot's
//! [`ActorPolicy`]s, which are plain numbers. Every random draw of the system comes from
//! [`randomness`]. Nothing here reads a file, a clock or a socket.

pub mod acting;
pub mod arrays;
pub mod categorical;
pub mod config;
pub mod error;
pub mod gaussian;
pub mod head;
pub mod initialise;
pub mod layers;
pub mod math;
pub mod network;
pub mod ops;
pub mod parameters;
pub mod precision;
pub mod probe;
pub mod randomness;
pub mod snapshot;
pub mod standardisation;

pub use acting::{ActorPolicy, ActorSpec, Scratch};
pub use arrays::{Array, NamedArrays};
pub use categorical::Categorical;
pub use config::{CoreKind, InputNorm, PolicyConfig, RefreshHidden};
pub use error::PolicyError;
pub use gaussian::Gaussian;
pub use head::{Distribution, Head};
pub use network::{ActorNetwork, SequenceInput, hold_sigma};
pub use parameters::Parameters;
pub use precision::Precision;
pub use probe::probe;
pub use randomness::{Draw, Key, Purpose, RunSeed, generator, standard_normal};
pub use snapshot::{PolicySnapshot, digest};
pub use standardisation::Standardisation;
