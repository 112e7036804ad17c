//! Lines that `metrics.jsonl` has lost, taken from the tables beside it before these are made again.

use std::path::Path;

use serde_json::Value;

use super::TABLES;
use crate::durable::FileError;
use crate::json_lines::{self, JsonLines, gaps, iterations};
use crate::plain_file;

/// Adds the lines up to `iteration` that only the tables have to `kept` and to the file, and reports what is lost.
///
/// # Errors
/// Names the file if it cannot be written.
pub(super) fn restore(
    run_folder: &Path,
    lines: &mut JsonLines,
    kept: &mut Vec<Value>,
    iteration: u64,
) -> Result<(), FileError> {
    let mut restored = Vec::new();
    for (name, kind) in TABLES {
        let text = plain_file::read_to_string(&run_folder.join(name)).unwrap_or_default();
        let mut present = iterations(kept, kind);
        restored.extend(rows(&text, kind).into_iter().filter(|row| {
            let at = row.value["iteration"].as_u64();
            at.is_some_and(|at| at <= iteration && present.insert(at))
        }));
    }
    let path = lines.path().display().to_string();
    if !restored.is_empty() {
        tracing::warn!(
            "{path} had lost {} lines; they are restored from the tables",
            restored.len()
        );
        kept.extend(restored.iter().map(|row| row.value.clone()));
        kept.sort_by_key(json_lines::place);
        lines.insert(restored.into_iter().map(|row| row.line).collect())?;
    }
    let lost = gaps(kept, "iteration", iteration);
    if !lost.is_empty() {
        tracing::warn!("{path} has no lines of iterations {}", lost.join(", "));
    }
    Ok(())
}

/// A row of a table as a line of the JSON file, with the digits of the table.
#[derive(Debug)]
struct Row {
    line: String,
    value: Value,
}

/// The rows of a table; rows of another length than the header's are left out.
fn rows(text: &str, kind: &str) -> Vec<Row> {
    let columns: Vec<&str> = text.lines().next().unwrap_or_default().split(',').collect();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        if cells.len() != columns.len() {
            return None;
        }
        let cell = |(column, cell): (&&str, &str)| {
            let cell = if cell.is_empty() { "null" } else { cell };
            format!("{}:{cell}", Value::from(*column))
        };
        let mut fields: Vec<String> = columns.iter().zip(cells).map(cell).collect();
        fields.push(format!("\"kind\":{}", Value::from(kind)));
        fields.sort();
        let line = format!("{{{}}}", fields.join(","));
        let value = serde_json::from_str(&line).ok()?;
        Some(Row { line, value })
    };
    // The last row may be half written.
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    whole.lines().skip(1).filter_map(row).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::config::MetricsConfig;
    use crate::metrics::{METRICS_FILE, Metrics};

    #[test]
    fn lines_that_the_json_file_lost_come_back_from_the_tables() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(METRICS_FILE);
        let config = MetricsConfig { csv: true, tensorboard: false };
        let line = |k: u64| {
            format!(
                "{{\"env_steps\":{},\"iteration\":{k},\"kind\":\"iteration\",\"x\":{k}.5}}\n",
                k * 40
            )
        };
        let evaluation =
            "{\"env_steps\":80,\"iteration\":2,\"kind\":\"evaluation\",\"mean\":1.25}\n";
        let whole = [line(1), line(2), evaluation.to_owned(), line(3), line(4)].concat();
        std::fs::write(&path, &whole).unwrap();
        drop(Metrics::open(folder.path(), &config, 4).unwrap());
        std::fs::write(&path, [line(1), line(4)].concat()).unwrap();
        let (_, measured) = Metrics::open(folder.path(), &config, 4).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), whole);
        assert_eq!(measured, BTreeSet::from([2]));
    }

    #[test]
    fn half_a_row_and_rows_of_later_iterations_are_not_restored() {
        let table = "iteration,env_steps,x\n1,40,0.5\n2,80,\n3,120,1.";
        let found = rows(table, "iteration");
        assert_eq!(found.len(), 2);
        assert_eq!(found[1].value["x"], Value::Null);
    }
}
