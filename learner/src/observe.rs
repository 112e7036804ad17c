//! Figures of a run for people and programs: events, the current snapshot, metrics files, and the page.

pub mod event;
pub mod metrics;
pub mod page;
pub mod snapshot;
