//! A learner under siege, with real processes: rubbish, crowds, connections that stop in the middle of whatever they say, and
//! actors that are lost. It keeps its memory and its descriptors, says what happened, and ends with the weights of a
//! learner that was left in peace.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[path = "../system/attackers.rs"]
mod attackers;
mod crowds;
mod frames;
mod incidents;
#[path = "../system/learners.rs"]
mod learners;
mod rubbish;
mod silence;
mod strangers;
mod usage;
