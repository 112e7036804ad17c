//! Other forms of `metrics.jsonl`, for programs that do not read JSON lines. They are made afresh from its
//! lines whenever a run starts or goes on, so they hold each iteration once, as it does.

use std::fmt::Debug;
use std::path::Path;
use std::time::SystemTime;

use serde_json::{Map, Value};

use super::TABLES;
use super::event_file::EventFile;
use super::table::Table;
use crate::config::MetricsConfig;
use crate::durable::FileError;

/// Folder of the event file, in the run folder.
const TENSORBOARD_FOLDER: &str = "tensorboard";

/// A file that follows `metrics.jsonl`.
pub(super) trait View: Debug + Send {
    /// Adds one line.
    fn add(&mut self, line: &Map<String, Value>) -> Result<(), FileError>;

    /// The file.
    fn path(&self) -> &Path;
}

/// Everything that follows `metrics.jsonl` in a run folder.
#[derive(Debug)]
pub(super) struct Views(Vec<Box<dyn View>>);

impl Views {
    /// Makes the views that `config` asks for from the lines so far.
    ///
    /// # Errors
    /// Names the file that cannot be written.
    pub(super) fn make(
        run_folder: &Path,
        config: &MetricsConfig,
        lines: &[Value],
    ) -> Result<Self, FileError> {
        let mut views: Vec<Box<dyn View>> = Vec::new();
        if config.csv {
            for (name, kind) in TABLES {
                views.push(Box::new(Table::make(run_folder.join(name), kind, lines)?));
            }
        }
        if config.tensorboard {
            let folder = run_folder.join(TENSORBOARD_FOLDER);
            views.push(Box::new(EventFile::make(&folder, lines, SystemTime::now())?));
        }
        Ok(Self(views))
    }

    /// Adds a line to all of them. One that cannot be written is told and followed no further: it can be made
    /// again from `metrics.jsonl`, so it must not end a run.
    pub(super) fn add(&mut self, line: &Map<String, Value>) {
        self.0.retain_mut(|view| match view.add(line) {
            Ok(()) => true,
            Err(error) => {
                let path = view.path().display();
                tracing::error!("{error}; {path} is made again when the run is resumed");
                false
            }
        });
    }
}
