//! A mixture of diagonal Gaussians over the standardised features, fitted by a fixed number of steps of
//! expectation and maximisation. Every fit starts afresh from its rows: nothing is drawn.

use libm::{exp, log, sqrt};
use policy::arrays::{Array, NamedArrays};
use rayon::prelude::*;

use super::moments::Moments;
use super::stored;
use crate::config::SurpriseConfig;
use crate::density::{Density, Observations, Occasion};
use crate::error::MarlError;
use crate::gaussian;

/// Weights, means and deviations of the components, in units of the moments' deviations.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussianMixture {
    moments: Moments,
    components: usize,
    steps: usize,
    /// `[K]`, summing to 1; a component that explains no row has 0.
    weight: Vec<f64>,
    /// `[K, C]` over the `C` features that count.
    mean: Vec<f64>,
    /// `[K, C]`.
    sigma: Vec<f64>,
}

impl GaussianMixture {
    /// A mixture that has seen nothing.
    pub(super) fn new(config: &SurpriseConfig, moments: Moments) -> Self {
        let (components, steps) = (config.components, config.em_steps);
        let weight = vec![1.0 / components as f64; components];
        Self { moments, components, steps, weight, mean: Vec::new(), sigma: Vec::new() }
    }

    fn standardised(&self, row: &[f32]) -> Vec<f64> {
        self.moments.counted().map(|i| self.moments.standard(row, i)).collect()
    }

    /// `log w_k + log N(x; mu_k, sigma_k)` of every component with a weight.
    fn joint<'a>(&'a self, x: &'a [f64]) -> impl Iterator<Item = (usize, f64)> + 'a {
        let weighted = (0..self.components).filter(|&k| self.weight[k] > 0.0);
        weighted.map(move |k| {
            let of = k * x.len()..(k + 1) * x.len();
            let density = gaussian::log_prob(x, &self.mean[of.clone()], &self.sigma[of]);
            (k, log(self.weight[k]) + density)
        })
    }

    /// `log sum_k w_k N(x; mu_k, sigma_k)`, nats.
    fn log_density(&self, x: &[f64]) -> f64 {
        let most = self.joint(x).fold(f64::NEG_INFINITY, |most, (_, value)| most.max(value));
        most + log(self.joint(x).map(|(_, value)| exp(value - most)).sum())
    }

    /// Each component's share in every row, `[R][K]`.
    fn responsibilities(&self, rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let shares = |x: &Vec<f64>| {
            let (total, mut shares) = (self.log_density(x), vec![0.0; self.components]);
            self.joint(x).for_each(|(k, value)| shares[k] = exp(value - total));
            shares
        };
        rows.par_iter().map(shares).collect()
    }

    /// The likeliest weights, means and deviations for these shares. A component without a share
    /// keeps its place and loses its weight.
    fn maximise(&mut self, rows: &[Vec<f64>], shares: &[Vec<f64>], floors: &[f64]) {
        let width = floors.len();
        for k in 0..self.components {
            let mass: f64 = shares.iter().map(|share| share[k]).sum();
            self.weight[k] = mass / rows.len() as f64;
            if mass <= 0.0 {
                continue;
            }
            let mean_of = |value: &dyn Fn(&[f64]) -> f64| {
                shares.iter().zip(rows).map(|(share, x)| share[k] * value(x)).sum::<f64>() / mass
            };
            for j in 0..width {
                let mean = mean_of(&|x| x[j]);
                let variance = mean_of(&|x| (x[j] - mean) * (x[j] - mean));
                self.mean[k * width + j] = mean;
                self.sigma[k * width + j] = sqrt(variance).max(floors[j]);
            }
        }
    }
}

/// `K` rows far from one another, as indices: the one nearest to the mean, which is 0, then again and
/// again the one farthest from all chosen; the first of equals.
fn farthest_rows(rows: &[Vec<f64>], components: usize) -> Vec<usize> {
    let origin = vec![0.0; rows[0].len()];
    let near: Vec<f64> = rows.iter().map(|row| -squared_distance(row, &origin)).collect();
    let mut chosen = vec![largest(&near)];
    let mut apart = vec![f64::INFINITY; rows.len()];
    while chosen.len() < components {
        let last = &rows[chosen[chosen.len() - 1]];
        let nearest = apart.iter_mut().zip(rows);
        nearest.for_each(|(apart, row)| *apart = apart.min(squared_distance(row, last)));
        chosen.push(largest(&apart));
    }
    chosen
}

/// Where the largest number stands, the first of equals.
fn largest(numbers: &[f64]) -> usize {
    (1..numbers.len()).fold(0, |best, i| if numbers[i] > numbers[best] { i } else { best })
}

fn squared_distance(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| (x - y) * (x - y)).sum()
}

/// All of a row's share goes to the nearest of the chosen rows.
fn nearest_shares(rows: &[Vec<f64>], chosen: &[usize]) -> Vec<Vec<f64>> {
    let one = |row: &Vec<f64>| {
        let near: Vec<f64> =
            chosen.iter().map(|&other| -squared_distance(row, &rows[other])).collect();
        let nearest = largest(&near);
        (0..chosen.len()).map(|k| if k == nearest { 1.0 } else { 0.0 }).collect()
    };
    rows.par_iter().map(one).collect()
}

impl Density for GaussianMixture {
    fn fit(
        &mut self,
        observations: Observations<'_>,
        _occasion: Occasion,
    ) -> Result<(), MarlError> {
        self.moments.fit(observations, 0.0);
        let rows: Vec<Vec<f64>> = observations.rows().map(|row| self.standardised(row)).collect();
        let floors: Vec<f64> = self.moments.counted().map(|i| self.moments.floor(i)).collect();
        self.mean = vec![0.0; self.components * floors.len()];
        self.sigma = vec![1.0; self.components * floors.len()];
        let chosen = farthest_rows(&rows, self.components);
        self.maximise(&rows, &nearest_shares(&rows, &chosen), &floors);
        for _ in 0..self.steps {
            let shares = self.responsibilities(&rows);
            self.maximise(&rows, &shares, &floors);
        }
        Ok(())
    }

    fn log_prob(
        &self,
        observations: Observations<'_>,
        _occasion: Occasion,
    ) -> Result<Vec<f64>, MarlError> {
        let volume = self.moments.log_volume();
        Ok(observations.map(|row| self.log_density(&self.standardised(row)) - volume))
    }

    fn features(&self) -> (usize, usize) {
        self.moments.features()
    }

    fn arrays(&self, prefix: &str) -> Result<NamedArrays, MarlError> {
        let mut arrays = self.moments.arrays(prefix);
        let wide = vec![self.components, self.mean.len() / self.components];
        let parts = [
            ("component_weight", vec![self.components], &self.weight),
            ("component_mean", wide.clone(), &self.mean),
            ("component_sigma", wide, &self.sigma),
        ];
        for (name, shape, data) in parts {
            arrays.insert(format!("{prefix}{name}"), Array::F64 { shape, data: data.clone() });
        }
        Ok(arrays)
    }

    fn restore(&mut self, prefix: &str, arrays: &NamedArrays) -> Result<(), MarlError> {
        let read = |name: &str, shape: &[Option<usize>]| {
            stored::reals(arrays, &format!("{prefix}{name}"), shape)
        };
        let mut moments = self.moments.clone();
        moments.restore(prefix, arrays)?;
        let one = Some(self.components);
        let wide = [one, Some(moments.features().0)];
        let weight = read("component_weight", &[one])?;
        let (mean, sigma) = (read("component_mean", &wide)?, read("component_sigma", &wide)?);
        *self = Self { moments, weight, mean, sigma, ..self.clone() };
        Ok(())
    }
}
