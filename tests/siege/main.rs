//! A learner under attack, with real processes: invalid messages, many peers, connections that stall, and
//! lost actors. Its memory and descriptors stay bounded, it logs each incident, and it ends with the weights of an
//! undisturbed learner.
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
