//! One agent's surprise: its density and the scores that are added to its reward.

use crate::density::{Density, DensityContext, Observations};
use crate::error::MarlError;
use crate::objective::surrogate::mean_and_deviation;
use crate::state::{Visitor, visit_count, visit_number};
use crate::surprise::entropy_bound;

/// A density and the results of its last fit.
pub(super) struct AgentSurprise {
    density: Box<dyn Density>,
    /// Number of fits. No computation reads it or `centre` again; both are stored because the hash of the state covers
    /// them.
    fits: i64,
    /// Mean log-density of the rows of the last fit, nats.
    centre: f64,
    /// The term that alpha multiplies, for every row of the last batch.
    scores: Vec<f64>,
    at_fit: (f64, f64, f64),
    /// Share of the bonus in the agent's reward over the last batch, both in magnitude.
    pub(super) share: f64,
}

impl AgentSurprise {
    pub(super) fn new(density: Box<dyn Density>) -> Self {
        Self {
            density,
            fits: 0,
            centre: 0.0,
            scores: Vec::new(),
            at_fit: (0.0, 0.0, 0.0),
            share: 0.0,
        }
    }

    /// Fits the density and scores the observations with it.
    pub(super) fn refit(
        &mut self,
        observations: Observations<'_>,
        context: DensityContext,
        alpha: f64,
    ) -> Result<(), MarlError> {
        self.density.fit(observations, context)?;
        let log_prob = self.density.log_prob(observations, context)?;
        (self.centre, self.fits) = (-entropy_bound(&log_prob), self.fits + 1);
        self.scores = self.without_constant(log_prob);
        let (mean, deviation) = mean_and_deviation(&self.scores);
        self.at_fit = (-self.centre, alpha * mean, alpha * deviation);
        Ok(())
    }

    /// The term that alpha multiplies, for each of the observations under the last fit, `[R]`.
    pub(super) fn score(
        &self,
        observations: Observations<'_>,
        context: DensityContext,
    ) -> Result<Vec<f64>, MarlError> {
        Ok(self.without_constant(self.density.log_prob(observations, context)?))
    }

    fn without_constant(&self, log_prob: Vec<f64>) -> Vec<f64> {
        let constant = self.density.omitted_constant();
        log_prob.into_iter().map(|l| l + constant).collect()
    }

    /// The term that alpha multiplies, for every row of the last batch, `[R]`.
    pub(super) fn scores(&self) -> &[f64] {
        &self.scores
    }

    /// Entropy bound of the observations, and mean and standard deviation of the bonus, at the last fit.
    pub(super) fn at_fit(&self) -> (f64, f64, f64) {
        self.at_fit
    }

    /// Number of active features and of features left out.
    pub(super) fn features(&self) -> (usize, usize) {
        self.density.features()
    }

    /// Visits the density's arrays, `PREFIXcentre` and `PREFIXfits`.
    pub(super) fn visit(
        &mut self,
        prefix: &str,
        visitor: &mut dyn Visitor,
    ) -> Result<(), MarlError> {
        self.density.visit(prefix, visitor)?;
        visit_number(visitor, &format!("{prefix}centre"), &mut self.centre)?;
        visit_count(visitor, &format!("{prefix}fits"), &mut self.fits)
    }

    /// Log-densities of rows with one feature, nats.
    #[cfg(test)]
    pub(super) fn log_prob(&self, rows: &[f32]) -> Vec<f64> {
        use policy::randomness::RunSeed;
        let context = DensityContext { seed: RunSeed(0), iteration: 0, agent: 0, query: 0 };
        self.density.log_prob(Observations { data: rows, width: 1 }, context).unwrap()
    }
}

#[cfg(test)]
mod tests {
    use policy::randomness::RunSeed;

    use super::*;
    use crate::config::DensityKind;
    use crate::density::build;
    use crate::distribution::gaussian::LOG_TWO_PI;

    const KINDS: [DensityKind; 4] = [
        DensityKind::DiagonalGaussian,
        DensityKind::Categorical,
        DensityKind::RandomEncoder,
        DensityKind::Vae,
    ];
    const CONTEXT: DensityContext =
        DensityContext { seed: RunSeed(0), iteration: 0, agent: 0, query: 0 };
    const ROWS: [f32; 8] = [1.0, 0.0, 3.0, 1.0, 5.0, 0.0, 7.0, 1.0];

    /// Scores and log-densities of the rows `[R, 2]` after a refit on them.
    fn scored(kind: DensityKind, data: &[f32]) -> (Vec<f64>, Vec<f64>) {
        let mut agent = AgentSurprise::new(build(kind, &[0, 1], (RunSeed(0), 0)).unwrap());
        let observations = Observations { data, width: 2 };
        agent.refit(observations, CONTEXT, 1.0).unwrap();
        let log_prob = agent.density.log_prob(observations, CONTEXT).unwrap();
        (agent.scores, log_prob)
    }

    #[test]
    fn scores_omit_the_constant_of_gaussians_and_nothing_of_a_categorical_density() {
        for kind in KINDS {
            // Two features of the observation count, or the eight outputs of the encoder.
            let omitted = match kind {
                DensityKind::Categorical => 0.0,
                DensityKind::RandomEncoder => 4.0 * LOG_TWO_PI,
                DensityKind::DiagonalGaussian | DensityKind::Vae => LOG_TWO_PI,
            };
            let (scores, log_prob) = scored(kind, &ROWS);
            for (score, log_prob) in scores.iter().zip(&log_prob) {
                assert!((score - log_prob - omitted).abs() < 1e-12, "{kind:?}");
            }
        }
    }

    #[test]
    fn without_active_features_every_density_scores_zero() {
        let still = [1.0, 2.0].repeat(4);
        for kind in KINDS {
            let (found, _) = scored(kind, &still);
            assert!(found.iter().all(|score| score.abs() < 1e-12), "{kind:?} {found:?}");
        }
    }
}
