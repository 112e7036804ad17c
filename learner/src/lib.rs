//! The learner: it hands out slots of environment steps, trains on what comes back, and keeps the run.
//!
//! [`trainer`] holds the loop that shows the whole data flow. [`service`] faces the network, and
//! [`exchange`] is where the two meet. Work, its states and its results are in [`slots`]; what a run
//! leaves on disk is in [`checkpoint`], [`metrics`], [`provenance`] and [`reward_log`]. The learner never steps a world.

pub mod assemble;
pub mod canary;
pub mod checkpoint;
pub mod config;
pub mod door;
pub mod durable;
pub mod environments;
pub mod error;
pub mod evaluation;
pub mod event;
pub mod exchange;
pub mod fault;
pub mod health;
pub mod json_lines;
pub mod launch;
pub mod metrics;
pub mod page;
pub mod provenance;
pub mod published;
pub mod reward_log;
pub mod run;
pub mod run_folder;
pub mod service;
pub mod slots;
pub mod snapshot;
mod team;
pub mod trainer;

pub use config::{
    CheckpointConfig, Config, EnvironmentsConfig, EvaluationConfig, LeaseConfig, MetricsConfig,
    Phase, ThreadsConfig,
};
pub use door::Door;
pub use error::LearnerError;
pub use event::{Event, IterationReport, Stage};
pub use exchange::Exchange;
pub use fault::Fault;
pub use launch::Launch;
pub use page::{Hosts, Page};
pub use run::run;
pub use snapshot::RunSnapshot;
pub use trainer::Summary;
