//! The slot table: each rule by a case worked by hand, and all of them together under random faults.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "slots/faults.rs"]
mod faults;
#[path = "slots/leases.rs"]
mod leases;
#[path = "slots/results.rs"]
mod results;
#[path = "slots/table.rs"]
mod table;
