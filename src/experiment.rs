//! Many runs from one file: tasks x variants x seeds. Reads the file, plans the runs, executes them, and compares them.

pub(crate) mod comparison;
pub(crate) mod file;
pub(crate) mod place;
pub(crate) mod plan;
pub(crate) mod progress;
pub(crate) mod record;
pub(crate) mod report;
pub(crate) mod results;
pub(crate) mod run_state;
pub(crate) mod scheduler;
pub(crate) mod selection;
pub(crate) mod submit;
