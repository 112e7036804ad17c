//! Comparison of a record with the folder of a run.

use super::{Record, name};
use crate::experiment::PlannedRun;

impl Record {
    /// Whether the run has the same evaluations and final weights in both records. The program that computed them may differ.
    pub(crate) fn agrees(&self, other: &Self, run: &PlannedRun) -> bool {
        let results = |record: &Self| {
            let known = record.0.get(&name(run))?;
            Some((known.evaluations.clone(), known.origin.weights_sha256.clone()))
        };
        results(self) == results(other)
    }
}
