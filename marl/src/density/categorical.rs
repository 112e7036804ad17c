//! An independent categorical distribution per feature, for features with few distinct values.

use std::collections::BTreeMap;

use libm::log;

use super::moments::Moments;
use crate::density::{Density, DensityContext, Observations};
use crate::error::MarlError;
use crate::state::{ArrayShape, Elements, Visitor};

/// Laplace smoothing: every value, and all unseen values together, count once more. An unseen value thus has a
/// probability, and log-probabilities are finite.
const SMOOTHING: f64 = 1.0;

/// Counts of each feature's values. The moments only determine which features vary.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CategoricalDensity {
    moments: Moments,
    /// Per signal feature, in ascending order of values.
    counts: Vec<BTreeMap<u32, i64>>,
    /// Number of rows, `R`.
    rows: i64,
}

impl CategoricalDensity {
    /// A density without counts.
    pub(super) fn new(moments: Moments) -> Self {
        let counts = vec![BTreeMap::new(); moments.signals()];
        Self { moments, counts, rows: 0 }
    }

    /// `log (n(v) + s) / (R + s (K + 1))` for `K` distinct values in `R` rows, summed over features.
    fn row(&self, row: &[f32]) -> f64 {
        let term = |i: usize| {
            let table = &self.counts[i];
            let seen = table.get(&order(row[self.moments.feature(i)])).copied().unwrap_or(0);
            let all = self.rows as f64 + SMOOTHING * (table.len() + 1) as f64;
            log((seen as f64 + SMOOTHING) / all)
        };
        self.moments.counted().map(term).sum()
    }
}

/// An integer with the same order as the value, equal for both zeros.
fn order(value: f32) -> u32 {
    let bits = (value + 0.0).to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

impl Density for CategoricalDensity {
    fn fit(
        &mut self,
        observations: Observations<'_>,
        _context: DensityContext,
    ) -> Result<(), MarlError> {
        self.moments.fit(observations);
        self.rows = observations.count() as i64;
        for (i, table) in self.counts.iter_mut().enumerate() {
            table.clear();
            for value in observations.column(self.moments.feature(i)) {
                *table.entry(order(value)).or_insert(0) += 1;
            }
        }
        Ok(())
    }

    fn log_prob(
        &self,
        observations: Observations<'_>,
        _context: DensityContext,
    ) -> Result<Vec<f64>, MarlError> {
        Ok(observations.map(|row| self.row(row)))
    }

    fn features(&self) -> (usize, usize) {
        self.moments.features()
    }

    fn omitted_constant(&self) -> f64 {
        0.0
    }

    /// Visits the moments, and `counts_I` of signal feature `I`: ordered values and counts, `[K, 2]`.
    fn visit(&mut self, prefix: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.moments.visit(prefix, visitor)?;
        for (i, table) in self.counts.iter_mut().enumerate() {
            let pairs = table.iter().flat_map(|(&value, &count)| [i64::from(value), count]);
            let (name, mut pairs) = (format!("{prefix}counts_{i}"), pairs.collect::<Vec<i64>>());
            visitor.array(&name, ArrayShape::Rows(&[2]), Elements::I64(&mut pairs))?;
            *table = pairs.chunks_exact(2).map(|pair| (pair[0] as u32, pair[1])).collect();
        }
        self.rows = self.counts.first().map_or(0, |table| table.values().sum());
        Ok(())
    }
}
