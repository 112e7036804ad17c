//! Losses and whole updates against values that `tests/reference/update_references.py` made with PyTorch in double
//! precision.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod file;
#[path = "../fixture/settings.rs"]
mod fixture;
mod losses;
mod settings;
mod updates;
