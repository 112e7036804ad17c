//! The slot table: each rule by a case worked by hand, and all of them together under random faults.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "slots/cluster.rs"]
mod cluster;
#[path = "slots/disturbances.rs"]
mod disturbances;
#[path = "slots/doubles.rs"]
mod doubles;
#[path = "slots/faults.rs"]
mod faults;
#[path = "slots/leases.rs"]
mod leases;
#[path = "slots/network.rs"]
mod network;
#[path = "slots/results.rs"]
mod results;
#[path = "slots/schedules.rs"]
mod schedules;
#[path = "slots/table.rs"]
mod table;
