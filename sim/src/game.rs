//! Games: tasks without physics, whose states are a few whole numbers.

pub(crate) mod cue;
