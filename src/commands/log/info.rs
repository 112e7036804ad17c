//! `s2mia log info`: contents of log files.

use std::path::Path;

use recording::trajectory_log::{Survey, read_bytes, survey};

use crate::cli::LogFiles;
use crate::commands::log::files::{in_file, paths};
use crate::figures::chart;
use crate::process::output;

/// One block for each file.
pub(super) fn run(logs: &LogFiles) -> anyhow::Result<()> {
    for path in paths(logs)? {
        let bytes = in_file(&path, read_bytes(&path))?;
        let survey = in_file(&path, survey(&bytes))?;
        output::line(block(&path, bytes.len(), &survey));
    }
    Ok(())
}

fn block(path: &Path, bytes: usize, survey: &Survey) -> String {
    let megabytes = bytes as f64 / 1e6;
    let mut lines = vec![format!("{} {megabytes:.1} MB, {:.1} s", path.display(), survey.secs)];
    let words = survey.words.iter().chain(&survey.totals);
    lines.extend(words.map(|(name, value)| format!("  {name:<20} {value}")));
    for (name, topic) in &survey.topics {
        let messages = chart::thousands(topic.messages);
        lines.push(format!("  {name:<20} {messages:>12} {}", topic.schema));
    }
    lines.join("\n")
}
