//! Metrics as CSV: one row per line of `metrics.jsonl`, one column per figure.

use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::view::View;
use crate::durable::{self, FileError};
use crate::plain_file;

/// First columns of every table.
const FIRST_COLUMNS: [&str; 2] = ["iteration", "env_steps"];

/// A table of the lines of one kind, open for appending. A figure keeps its column. A new figure gets a column at the
/// right, which is empty in earlier rows.
#[derive(Debug)]
pub(super) struct Table {
    kind: &'static str,
    path: PathBuf,
    file: File,
    columns: Vec<String>,
}

impl Table {
    /// Writes a new table of all lines of `kind`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn make(
        path: PathBuf,
        kind: &'static str,
        lines: &[Value],
    ) -> Result<Self, FileError> {
        let lines = || lines.iter().filter_map(Value::as_object).filter(|line| of(line, kind));
        let mut columns = FIRST_COLUMNS.map(str::to_owned).to_vec();
        for line in lines() {
            columns.extend(new_columns(&columns, line));
        }
        let rows = lines().map(|line| row(&columns, line)).collect::<String>();
        durable::replace(&path, format!("{}\n{rows}", columns.join(",")).as_bytes())?;
        let file = append_to(&path)?;
        Ok(Self { kind, path, file, columns })
    }

    /// Rewrites the file with more columns, which are empty in all rows so far.
    fn widen(&mut self, more: Vec<String>) -> Result<(), FileError> {
        let text =
            plain_file::read_to_string(&self.path).map_err(FileError::of("read", &self.path))?;
        self.columns.extend(more.iter().cloned());
        let rows = text.lines().skip(1).map(|row| row.to_owned() + &",".repeat(more.len()) + "\n");
        let wider = format!("{}\n{}", self.columns.join(","), rows.collect::<String>());
        durable::replace(&self.path, wider.as_bytes())?;
        self.file = append_to(&self.path)?;
        Ok(())
    }
}

impl View for Table {
    fn add(&mut self, line: &Map<String, Value>) -> Result<(), FileError> {
        if !of(line, self.kind) {
            return Ok(());
        }
        let more = new_columns(&self.columns, line);
        if !more.is_empty() {
            self.widen(more)?;
        }
        let row = row(&self.columns, line);
        self.file.write_all(row.as_bytes()).map_err(FileError::of("append to", &self.path))
    }

    fn path(&self) -> &Path {
        &self.path
    }
}

fn append_to(path: &Path) -> Result<File, FileError> {
    plain_file::append(path).map_err(FileError::of("open", path))
}

fn of(line: &Map<String, Value>, kind: &str) -> bool {
    line.get("kind").is_some_and(|found| found == kind)
}

/// Names of the line's figures without a column.
fn new_columns(columns: &[String], line: &Map<String, Value>) -> Vec<String> {
    let new = |name: &&String| *name != "kind" && !columns.contains(name);
    line.keys().filter(new).cloned().collect()
}

/// One row. All cells are numbers, so none needs quotes; missing and non-finite figures are empty.
fn row(columns: &[String], line: &Map<String, Value>) -> String {
    let cell = |column: &String| match line.get(column) {
        Some(Value::Number(number)) => number.to_string(),
        _ => String::new(),
    };
    columns.iter().map(cell).collect::<Vec<_>>().join(",") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_new_figure_gets_a_column_and_a_rewritten_table_is_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.csv");
        let lines = [
            json!({"kind": "iteration", "iteration": 1, "env_steps": 40, "b": 0.5, "a": null}),
            json!({"kind": "evaluation", "iteration": 1, "env_steps": 40, "mean": 2.0}),
            json!({"kind": "iteration", "iteration": 2, "env_steps": 80, "b": 1.5, "a": 3, "c": -1}),
        ];
        let mut table = Table::make(path.clone(), "iteration", &lines[..1]).unwrap();
        for line in &lines[1..] {
            table.add(line.as_object().unwrap()).unwrap();
        }
        let appended = std::fs::read_to_string(&path).unwrap();
        assert_eq!(appended, "iteration,env_steps,a,b,c\n1,40,,0.5,\n2,80,3,1.5,-1\n");
        Table::make(path.clone(), "iteration", &lines).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), appended);
    }
}
