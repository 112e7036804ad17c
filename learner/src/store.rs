//! The files of a run folder: which process may write to it, checkpoints, and how they are written.

pub mod checkpoint;
pub mod durable;
pub mod json_lines;
pub mod plain_file;
pub mod run_folder;
