//! Sorts the lines of a file for a run that continues after an iteration.

use serde_json::Value;

use super::of_iteration;
use crate::store::durable;

/// The lines of a file when a run continues after an iteration.
#[derive(Default)]
pub(super) struct SortedLines<'a> {
    /// Bytes of the lines up to that iteration.
    pub(super) content: Vec<u8>,
    /// Their values.
    pub(super) kept: Vec<Value>,
    /// Invalid lines.
    pub(super) damaged: Vec<&'a [u8]>,
    /// Valid lines of later iterations, if the run begins again.
    pub(super) earlier: Vec<&'a [u8]>,
}

impl<'a> SortedLines<'a> {
    pub(super) fn of(text: &'a [u8], iteration: u64) -> Self {
        let mut sorted = Self::default();
        for line in text.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            match of_iteration(line) {
                Some((found, value)) if found <= iteration => {
                    sorted.content.extend_from_slice(line);
                    sorted.content.push(b'\n');
                    sorted.kept.push(value);
                }
                Some(_) if iteration == 0 => sorted.earlier.push(line),
                Some(_) => {}
                None => sorted.damaged.push(line),
            }
        }
        // A crash may leave half of the last line.
        let last = &text[durable::whole_lines(text)..];
        if !last.is_empty() && of_iteration(last).is_none() {
            sorted.damaged.pop();
        }
        sorted
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_number_that_is_read_is_the_one_that_was_written() {
        for written in
            [-0.367_341_361_445_141_96, 0.957_057_296_502_171_1, -1.142_174_923_923_448_7]
        {
            let line = format!("{}\n", json!({"iteration": 1, "x": written}));
            let sorted = SortedLines::of(line.as_bytes(), 1);
            assert_eq!(sorted.kept[0]["x"].as_f64(), Some(written));
        }
    }
}
