//! Comparison of a record with the folder of a run.

use super::{Evaluation, FinishedRun, Record, name};
use crate::experiment::PlannedRun;

/// Largest relative difference of equal numbers: a program that edits tables may round them.
const ROUNDING: f64 = 1e-9;

impl Record {
    /// Whether the run has the same evaluations and final weights in both records. The program that computed them may differ.
    pub(crate) fn agrees(&self, other: &Self, run: &PlannedRun) -> bool {
        match [self, other].map(|record| record.0.get(&name(run))) {
            [Some(one), Some(other)] => one.agrees(other),
            known => known == [None, None],
        }
    }
}

impl FinishedRun {
    fn agrees(&self, other: &Self) -> bool {
        let mut pairs = self.evaluations.iter().zip(&other.evaluations);
        self.origin.weights_sha256 == other.origin.weights_sha256
            && self.evaluations.len() == other.evaluations.len()
            && pairs.all(|(one, other)| one.agrees(other))
    }
}

impl Evaluation {
    fn agrees(&self, other: &Self) -> bool {
        let near = |a: f64, b: f64| (a - b).abs() <= ROUNDING * a.abs().max(b.abs());
        let alike = |a: Option<f64>, b: Option<f64>| match (a, b) {
            (Some(a), Some(b)) => near(a, b),
            (a, b) => a == b,
        };
        self.env_steps == other.env_steps
            && near(self.mean_return, other.mean_return)
            && alike(self.surprise, other.surprise)
            && alike(self.information, other.information)
    }
}
