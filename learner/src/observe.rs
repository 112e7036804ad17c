//! Reporting of a run: events, the current snapshot, and metrics files.

pub mod event;
pub mod metrics;
pub mod snapshot;
