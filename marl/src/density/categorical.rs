//! An independent categorical distribution per feature, for features that take few values.

use std::collections::BTreeMap;

use libm::log;
use policy::arrays::{Array, NamedArrays};

use super::moments::Moments;
use super::stored;
use crate::density::{Density, Observations, Occasion};
use crate::error::MarlError;

/// Laplace's rule of succession: every value, and all that were never seen together, occurred once
/// more than they did. So an unseen value has a probability, and log-probabilities stay finite.
const SMOOTHING: f64 = 1.0;

/// How often each feature took each value. Moments only tell which features vary.
#[derive(Clone, Debug, PartialEq)]
pub struct Categorical {
    moments: Moments,
    /// Per signal feature; a table's order is that of the values.
    counts: Vec<BTreeMap<u32, i64>>,
    /// `R`, rows counted.
    rows: i64,
}

impl Categorical {
    /// Nothing counted yet.
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

/// A number whose order is the value's, the same for both zeros.
fn order(value: f32) -> u32 {
    let bits = (value + 0.0).to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

impl Density for Categorical {
    fn fit(
        &mut self,
        observations: Observations<'_>,
        _occasion: Occasion,
    ) -> Result<(), MarlError> {
        self.moments.fit(observations, 0.0);
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
        _occasion: Occasion,
    ) -> Result<Vec<f64>, MarlError> {
        Ok(observations.map(|row| self.row(row)))
    }

    fn features(&self) -> (usize, usize) {
        self.moments.features()
    }

    /// The moments, and `counts_I` of the signal feature `I`: values by their order and counts,
    /// `[K, 2]`.
    fn arrays(&self, prefix: &str) -> Result<NamedArrays, MarlError> {
        let mut arrays = self.moments.arrays(prefix);
        for (i, table) in self.counts.iter().enumerate() {
            let data = table.iter().flat_map(|(&value, &count)| [i64::from(value), count]);
            let array = Array::I64 { shape: vec![table.len(), 2], data: data.collect() };
            arrays.insert(format!("{prefix}counts_{i}"), array);
        }
        Ok(arrays)
    }

    fn restore(&mut self, prefix: &str, arrays: &NamedArrays) -> Result<(), MarlError> {
        let table = |i: usize| {
            let name = format!("{prefix}counts_{i}");
            let numbers = stored::integers(arrays, &name, &[None, Some(2)])?;
            let pairs = numbers.chunks_exact(2).map(|pair| (pair[0] as u32, pair[1]));
            Ok(pairs.collect())
        };
        let counts = (0..self.counts.len())
            .map(table)
            .collect::<Result<Vec<BTreeMap<_, _>>, MarlError>>()?;
        self.moments.restore(prefix, arrays)?;
        self.rows = counts.first().map_or(0, |table| table.values().sum());
        self.counts = counts;
        Ok(())
    }
}
