//! Reporting of a run: events, the current snapshot, metrics files, and the web page.

pub mod event;
pub mod metrics;
pub mod page;
pub mod snapshot;
