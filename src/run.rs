//! Runs on this machine: starting, resuming, supervising, serving and checking them.

pub(crate) mod checkpointed;
pub(crate) mod determinism;
pub(crate) mod launch;
pub(crate) mod message_sizes;
pub(crate) mod new_folder;
pub(crate) mod offered;
pub(crate) mod process_log;
pub(crate) mod resume;
pub(crate) mod run_path;
pub(crate) mod supervisor;
