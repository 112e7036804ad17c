//! Names of the records in a log file.

/// Name of the metadata record with the run, task and actor of a log.
pub(super) const METADATA_NAME: &str = "s2mia.log";
/// Name of the metadata record at the end of a log with the numbers of written and lost shares and steps.
pub(super) const TOTALS_NAME: &str = "s2mia.log.totals";
/// Name of the attachment with the task's settings.
pub(super) const TASK_NAME: &str = "task.json";
/// Name of the attachment with the run's resolved settings.
pub(super) const SETTINGS_NAME: &str = "config.toml";
