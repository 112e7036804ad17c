//! The learner: it leases slots of environment steps to actors, trains on the results, and writes the run folder.
//!
//! The modules follow the data. [`service`] receives messages. [`exchange`] passes them to the table of [`slots`]
//! and complete slots to the [`trainer`], whose loop shows the whole data flow. [`checkpoint`] writes
//! to disk. [`snapshot`], [`metrics`] and [`page`] report. The learner never steps a world.

pub mod config;
pub mod error;
pub mod launch;
mod lease;
mod observe;
pub mod run;
mod serve;
mod store;
mod train;

pub use config::{
    AuditConfig, CheckpointConfig, Config, EnvironmentsConfig, EvaluationConfig, Fingerprint,
    LeaseConfig, MetricsConfig, Phase, ThreadsConfig,
};
pub use error::LearnerError;
pub use event::{Event, IterationReport, Stage};
pub use exchange::Exchange;
pub use launch::Launch;
pub use lease::{canary, check, end_states, exchange, published, sample, slots};
pub use listener::Listener;
pub use observe::{event, metrics, page, snapshot};
pub use page::{Hosts, NotAHost, OverlaidRun, Overlay, Page, serve_overlay};
pub use run::run;
use serve::{accepting, team, token};
pub use serve::{health, listener, service};
pub use snapshot::RunSnapshot;
pub use store::{checkpoint, durable, json_lines, plain_file, run_folder};
pub use train::{assemble, environments, evaluation, trainer};
pub use trainer::Summary;
