//! Other formats of `metrics.jsonl`. They are written anew from its lines when a run starts or resumes, so they also
//! show each iteration exactly once.

use std::path::Path;
use std::time::SystemTime;

use serde_json::{Map, Value};

use super::TABLES;
use super::event_file::EventFile;
use super::table::Table;
use super::view::View;
use crate::config::MetricsConfig;
use crate::durable::FileError;

/// Folder of the event file, in the run folder.
const TENSORBOARD_FOLDER: &str = "tensorboard";

/// The enabled views of a run.
#[derive(Debug)]
pub(super) struct Views(Vec<Box<dyn View>>);

impl Views {
    /// Writes the views that `config` enables from the lines so far.
    ///
    /// # Errors
    /// A file cannot be written.
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

    /// Adds a line to all views. A view that cannot be written is logged and dropped instead of ending the run, because
    /// it can be rewritten from `metrics.jsonl`.
    pub(super) fn add(&mut self, line: &Map<String, Value>) {
        self.0.retain_mut(|view| match view.add(line) {
            Ok(()) => true,
            Err(error) => {
                let path = view.path().display();
                tracing::error!("{error}; {path} is rewritten when the run is resumed");
                false
            }
        });
    }
}
