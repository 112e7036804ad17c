//! Measured figures as Markdown and as JSON.

use serde_json::{Map, Value, json};

/// Names with units, and values; NaN if unavailable on this machine.
pub(crate) type Figures = Vec<(&'static str, f64)>;

/// One case and its figures; all rows of a section have the same names, units included.
pub(crate) struct CaseRow {
    /// Name of the case.
    pub(crate) case: String,
    /// Figures.
    pub(crate) figures: Figures,
}

/// The rows of one section.
pub(crate) struct Section {
    /// Name on the command line.
    pub(crate) name: &'static str,
    /// Description of the rows.
    pub(crate) caption: &'static str,
    /// The rows, at least one.
    pub(crate) rows: Vec<CaseRow>,
}

impl Section {
    /// Formats a heading and a table.
    pub(crate) fn to_markdown(&self) -> String {
        let names: Vec<&str> = self.rows[0].figures.iter().map(|(name, _)| *name).collect();
        let mut text = format!("### {}: {}\n\n", self.name, self.caption);
        text += &format!("| case | {} |\n", names.join(" | "));
        text += &format!("| --- |{}\n", " --- |".repeat(names.len()));
        for row in &self.rows {
            let values: Vec<String> = row.figures.iter().map(|(_, value)| shown(*value)).collect();
            text += &format!("| {} | {} |\n", row.case, values.join(" | "));
        }
        text
    }
}

/// `{section: {case: {name: value}}}`.
pub(crate) fn to_json(sections: &[Section]) -> Value {
    let row = |row: &CaseRow| {
        let figures = row.figures.iter().map(|(name, value)| ((*name).to_owned(), json!(value)));
        (row.case.clone(), Value::Object(figures.collect()))
    };
    let section = |section: &Section| {
        let rows: Map<String, Value> = section.rows.iter().map(row).collect();
        (section.name.to_owned(), Value::Object(rows))
    };
    Value::Object(sections.iter().map(section).collect())
}

/// Three significant digits below a thousand, whole numbers above.
fn shown(value: f64) -> String {
    match value.abs() {
        size if size.is_nan() => "-".to_owned(),
        0.0 => "0".to_owned(),
        size if size >= 100.0 || value.fract() == 0.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 1.0 => format!("{value:.2}"),
        _ => format!("{value:.4}"),
    }
}
