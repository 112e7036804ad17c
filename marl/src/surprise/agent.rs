//! One agent's surprise: its density and the scores that are added to its reward.

use libm::sqrt;

use crate::config::{Constant, Fit, Reduce, SurpriseConfig};
use crate::density::{Density, DensityContext, Observations};
use crate::distribution::gaussian::LOG_TWO_PI;
use crate::error::MarlError;
use crate::state::{Visitor, visit_count, visit_number};
use crate::surprise::entropy_bound;

/// Conversion of log-densities to scores.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rule {
    pub(super) alpha: f64,
    fit: Fit,
    memory: f64,
    constant: Constant,
    reduce: Reduce,
    /// Infinite without clipping.
    clip: f64,
}

impl Rule {
    pub(super) fn of(config: &SurpriseConfig) -> Self {
        let SurpriseConfig { alpha, fit, constant, reduce, .. } = *config;
        let memory = if fit == Fit::Ema { config.ema_memory } else { 0.0 };
        let clip = if config.clip > 0.0 { config.clip } else { f64::INFINITY };
        Self { alpha, fit, memory, constant, reduce, clip }
    }
}

/// A density and the results of its last fit.
pub(super) struct AgentSurprise {
    density: Box<dyn Density>,
    /// Number of fits.
    fits: i64,
    /// Mean log-density of the rows of the last fit, nats.
    centre: f64,
    /// The term that alpha multiplies, for every row of the last batch.
    scores: Vec<f64>,
    at_fit: (f64, f64, f64),
    /// Share of the bonus in the return of the last batch.
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

    /// Fits the density and scores the observations with the density after or before the fit, as the rule selects.
    pub(super) fn refit(
        &mut self,
        observations: Observations<'_>,
        context: DensityContext,
        rule: Rule,
    ) -> Result<(), MarlError> {
        let memory = if self.fits > 0 { rule.memory } else { 0.0 };
        let context = DensityContext { memory, ..context };
        let score_before_fit = match rule.fit {
            Fit::Current | Fit::Ema => None,
            Fit::Previous => Some(self.score_before_fit(observations, context, rule)?),
        };
        self.density.fit(observations, context)?;
        let log_prob = self.density.log_prob(observations, context)?;
        (self.centre, self.fits) = (-entropy_bound(&log_prob), self.fits + 1);
        let score_after_fit = || (self.scored(&log_prob, rule), -self.centre);
        let (scores, bound) = score_before_fit.unwrap_or_else(score_after_fit);
        let (mean, deviation) = mean_and_deviation(&scores);
        self.at_fit = (bound, rule.alpha * mean, rule.alpha * deviation);
        self.scores = scores;
        Ok(())
    }

    /// Scores and entropy bound before the fit; zeros before the first fit.
    fn score_before_fit(
        &self,
        observations: Observations<'_>,
        context: DensityContext,
        rule: Rule,
    ) -> Result<(Vec<f64>, f64), MarlError> {
        if self.fits == 0 {
            return Ok((vec![0.0; observations.count()], 0.0));
        }
        let log_prob = self.density.log_prob(observations, context)?;
        Ok((self.scored(&log_prob, rule), entropy_bound(&log_prob)))
    }

    /// Scores from log-densities: constant, reduction over features, and clipping; nats.
    fn scored(&self, log_prob: &[f64], rule: Rule) -> Vec<f64> {
        let counted = self.features().0 as f64;
        let constant = match rule.constant {
            Constant::Density => 0.0,
            Constant::Paper => 0.5 * LOG_TWO_PI * counted,
            Constant::Centered => -self.centre,
        };
        let features = match rule.reduce {
            Reduce::Sum => 1.0,
            Reduce::Mean => counted.max(1.0),
        };
        let score = |l: &f64| ((l + constant) / features).clamp(-rule.clip, rule.clip);
        log_prob.iter().map(score).collect()
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
        let context = DensityContext { seed: RunSeed(0), iteration: 0, agent: 0, memory: 0.0 };
        self.density.log_prob(Observations { data: rows, width: 1 }, context).unwrap()
    }
}

fn mean_and_deviation(numbers: &[f64]) -> (f64, f64) {
    let count = numbers.len() as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    (mean, sqrt(numbers.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count))
}

#[cfg(test)]
mod tests {
    use libm::log;
    use policy::randomness::RunSeed;

    use super::*;
    use crate::config::DensityKind;
    use crate::density::build;
    use crate::sample;
    use crate::state::{restored, saved};

    const HERE: [f32; 8] = [1.0, 0.0, 3.0, 1.0, 5.0, 0.0, 7.0, 1.0];
    const THERE: [f32; 8] = [2.0, 0.0, 2.0, 0.5, 9.0, 0.0, 7.0, 1.0];

    fn config() -> SurpriseConfig {
        SurpriseConfig { alpha: 1.0, constant: Constant::Density, ..sample::surprise() }
    }

    /// Scores of the last of `batches` `[R, 2]`, after a refit on each in order.
    fn scores(config: &SurpriseConfig, batches: &[&[f32]]) -> Vec<f64> {
        let mut agent = AgentSurprise::new(build(config, &[0, 1], (RunSeed(0), 0)).unwrap());
        for (iteration, data) in batches.iter().enumerate() {
            let iteration = iteration as u64;
            let context = DensityContext { seed: RunSeed(0), iteration, agent: 0, memory: 0.0 };
            agent.refit(Observations { data, width: 2 }, context, Rule::of(config)).unwrap();
        }
        agent.scores
    }

    #[test]
    fn with_fit_previous_the_last_density_scores_and_iteration_zero_has_no_bonus() {
        let previous = SurpriseConfig { fit: Fit::Previous, ..config() };
        assert_eq!(scores(&previous, &[&HERE]), vec![0.0; 4]);
        let found = scores(&previous, &[&HERE, &THERE]);
        // Means 4 and 1/2, variances 5 and 1/4 of HERE; the first row of THERE is (2, 0).
        let by_hand = -0.5 * (4.0 / 5.0 + log(5.0) + 1.0 + log(0.25)) - LOG_TWO_PI;
        assert!((found[0] - by_hand).abs() < 1e-9, "{found:?} {by_hand}");
    }

    #[test]
    fn a_restored_agent_scores_like_the_stored_one() {
        let config =
            SurpriseConfig { fit: Fit::Previous, constant: Constant::Centered, ..config() };
        let agent = || AgentSurprise::new(build(&config, &[0, 1], (RunSeed(0), 0)).unwrap());
        let context = DensityContext { seed: RunSeed(0), iteration: 0, agent: 0, memory: 0.0 };
        let refit = |agent: &mut AgentSurprise, data: &[f32]| {
            let observations = Observations { data, width: 2 };
            agent.refit(observations, context, Rule::of(&config)).unwrap();
        };
        let (mut kept, mut other) = (agent(), agent());
        refit(&mut kept, &HERE);
        let arrays = saved("", |visitor| kept.visit("a.", visitor)).unwrap();
        restored(&arrays, |visitor| other.visit("a.", visitor)).unwrap();
        refit(&mut kept, &THERE);
        refit(&mut other, &THERE);
        assert_eq!(kept.scores, other.scores);
        assert!(kept.scores.iter().any(|score| *score != 0.0));
    }

    #[test]
    fn ema_memory_has_an_effect_only_after_the_first_fit() {
        let ema = SurpriseConfig { fit: Fit::Ema, ..config() };
        assert_eq!(scores(&ema, &[&HERE]), scores(&config(), &[&HERE]));
        assert_ne!(scores(&ema, &[&HERE, &THERE]), scores(&config(), &[&HERE, &THERE]));
        let forgetful = SurpriseConfig { ema_memory: 0.0, ..ema };
        assert_eq!(scores(&forgetful, &[&HERE, &THERE]), scores(&config(), &[&THERE]));
    }

    #[test]
    fn constants_shift_all_scores_equally_and_centred_scores_have_mean_zero() {
        let of = |constant| scores(&SurpriseConfig { constant, ..config() }, &[&HERE]);
        let (density, paper, centred) =
            (of(Constant::Density), of(Constant::Paper), of(Constant::Centered));
        for row in 0..4 {
            assert!((paper[row] - density[row] - LOG_TWO_PI).abs() < 1e-12); // two features count
        }
        assert!(centred.iter().sum::<f64>().abs() < 1e-12);
    }

    #[test]
    fn mean_divides_by_the_active_features_and_clip_limits_both_signs() {
        let sum = scores(&config(), &[&HERE]);
        let mean = scores(&SurpriseConfig { reduce: Reduce::Mean, ..config() }, &[&HERE]);
        assert!(sum.iter().zip(&mean).all(|(sum, mean)| (sum / 2.0 - mean).abs() < 1e-12));
        let clip = 2.6;
        let clipped = scores(&SurpriseConfig { clip, ..config() }, &[&HERE]);
        assert!(sum.iter().zip(&clipped).all(|(s, c)| s.clamp(-clip, clip) == *c));
        assert_ne!(sum, clipped);
    }

    #[test]
    fn without_active_features_every_density_scores_zero() {
        let still = [1.0, 2.0].repeat(4);
        for density in [DensityKind::DiagonalGaussian, DensityKind::Categorical, DensityKind::Vae] {
            let found = scores(&SurpriseConfig { density, ..config() }, &[&still]);
            assert!(found.iter().all(|score| score.abs() < 1e-12), "{density:?} {found:?}");
        }
    }
}
