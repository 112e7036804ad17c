//! Compares lines of a run's records with those that were computed again.

use learner::observe::event::INCIDENTAL;
use serde_json::Value;

use crate::run::recorded::Lines;

/// Compares the lines of an iteration in a file, but for what is incidental.
pub(super) fn same(
    file: &str,
    kind: &str,
    (iteration, recorded, found): (u64, &Lines, &Lines),
) -> anyhow::Result<()> {
    let lines = [recorded, found].map(|lines| lines.get(&iteration).cloned().unwrap_or_default());
    let [old, new] = &lines;
    let fields = lines.iter().filter_map(Value::as_object).flat_map(|line| line.keys());
    let mut relevant = fields.filter(|field| !INCIDENTAL.contains(&field.as_str()));
    match relevant.find(|field| old[field.as_str()] != new[field.as_str()]) {
        None => Ok(()),
        Some(field) => anyhow::bail!(
            "{kind} {iteration} has {field} {}, {file} has {}",
            new[field],
            old[field]
        ),
    }
}

#[cfg(test)]
mod tests {
    use learner::store::run_folder::METRICS;
    use serde_json::json;

    use super::*;

    #[test]
    fn lines_differ_by_any_field_but_those_of_time_and_place() {
        let line = json!({"iteration": 3, "loss": 0.5, "iteration_secs": 1.0, "slots": []});
        let compared = |field: &str, value: Value| {
            let mut other = line.clone();
            other[field] = value;
            let of = |line: &Value| Lines::from([(3, line.clone())]);
            same(METRICS, "iteration", (3, &of(&line), &of(&other))).map_err(|why| why.to_string())
        };
        assert_eq!(compared("iteration_secs", json!(2.0)), Ok(()));
        assert_eq!(compared("slots", json!([1])), Ok(()));
        let difference = "iteration 3 has loss 0.25, metrics.jsonl has 0.5";
        assert_eq!(compared("loss", json!(0.25)), Err(difference.to_owned()));
        let difference = "iteration 3 has more 1, metrics.jsonl has null";
        assert_eq!(compared("more", json!(1)), Err(difference.to_owned()));
    }
}
