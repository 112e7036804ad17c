//! The settings of a run: layers of TOML, environment variables and `key=value`, each value with its origin.
//! `config/run_config.rs` and the crates interpret the values.

mod agents;
mod conditions;
pub(crate) mod effect;
pub(crate) mod keys;
pub(crate) mod known;
pub(crate) mod layers;
pub(crate) mod message_steps;
pub(crate) mod own_task;
pub(crate) mod presets;
pub(crate) mod resolved;
mod rules;
pub(crate) mod run_config;

pub(crate) use layers::Request;
pub(crate) use resolved::{ConfigError, Resolved, line_and_message};
