//! Where a run's settings come from: layers of TOML, environment variables and `key=value`, each value
//! with its origin. What the values mean is decided in `run_config.rs` and by the crates they belong to.

pub(crate) mod error;
pub(crate) mod keys;
pub(crate) mod layers;
pub(crate) mod presets;
pub(crate) mod resolved;
pub(crate) mod scalar;

pub(crate) use error::ConfigError;
pub(crate) use layers::Request;
pub(crate) use resolved::Resolved;
