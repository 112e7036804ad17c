//! Tests of the slot table: single rules with small cases, and all rules together with random faults.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "slots/backups.rs"]
mod backups;
#[path = "slots/cluster.rs"]
mod cluster;
#[path = "slots/episodes.rs"]
mod episodes;
#[path = "slots/events.rs"]
mod events;
#[path = "slots/leases.rs"]
mod leases;
#[path = "slots/network.rs"]
mod network;
#[path = "slots/results.rs"]
mod results;
#[path = "slots/returned.rs"]
mod returned;
#[path = "slots/shares.rs"]
mod shares;
#[path = "slots/table.rs"]
mod table;
