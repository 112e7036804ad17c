//! The files of a run folder: checkpoints, provenance, and how they are written.

pub mod checkpoint;
pub mod durable;
pub mod json_lines;
pub mod plain_file;
pub mod provenance;
pub mod run_folder;
