//! An independent Gaussian per output of a fixed random network of the observation, as in E2M.

use policy::ops::{LayerStack, Weights};
use policy::parameters::Parameters;
use policy::randomness::{Draw, Purpose, RunSeed, generator};

use super::diagonal_gaussian::DiagonalGaussian;
use super::moments::Moments;
use crate::density::{Density, DensityContext, Observations};
use crate::error::MarlError;
use crate::optimisation::layers::{Normalisation, rectified_layers, rows};
use crate::state::Visitor;

/// Units of each hidden layer, as those of `vae`.
const HIDDEN: usize = 64;
/// Hidden layers.
const LAYERS: usize = 2;
/// Outputs. Surprise needs a low-dimensional representation (E2M: Hou et al., "Cooperative Multiagent Learning and
/// Exploration With Min-Max Intrinsic Motivation", IEEE Transactions on Cybernetics 55(6), 2025); the latent of `vae` has
/// as many dimensions.
pub(super) const OUTPUTS: usize = 8;

/// Layers of Linear and ReLU, then a linear layer, and a Gaussian per output. A run's seed and an agent's index determine
/// the network, so it is not part of the state.
pub(crate) struct RandomEncoder {
    signal: Vec<usize>,
    encoder: Weights,
    gaussian: DiagonalGaussian,
}

impl RandomEncoder {
    /// A network of the features `signal` with weights drawn for agent `agent`.
    pub(super) fn new(
        signal: Vec<usize>,
        (seed, agent): (RunSeed, u32),
    ) -> Result<Self, MarlError> {
        let mut rng = generator(seed, Draw::of(Purpose::DensityInitialisation).agent(agent));
        let specs = rectified_layers((signal.len(), HIDDEN, LAYERS), Normalisation::None, OUTPUTS);
        let layers = LayerStack::declare(&mut Parameters::new(), &specs, &mut rng)?;
        let gaussian = DiagonalGaussian(Moments::new((0..OUTPUTS).collect()));
        Ok(Self { signal, encoder: layers.constant_weights()?, gaussian })
    }

    /// `f(o)` of every row, `[R, outputs]`.
    fn encoded(&self, observations: Observations<'_>) -> Result<Vec<f32>, MarlError> {
        let signal = |row: &[f32]| self.signal.iter().map(|&i| row[i]).collect::<Vec<_>>();
        let inputs = rows(observations.rows().flat_map(signal).collect(), self.signal.len())?;
        Ok(self.encoder.apply(&inputs, None)?.flatten_all()?.to_vec1()?)
    }

    /// The network's outputs as the observations of the Gaussian.
    fn outputs<'a>(&self, encoded: &'a [f32]) -> Observations<'a> {
        Observations { data: encoded, width: self.gaussian.0.signals() }
    }
}

impl Density for RandomEncoder {
    fn fit(
        &mut self,
        observations: Observations<'_>,
        context: DensityContext,
    ) -> Result<(), MarlError> {
        let encoded = self.encoded(observations)?;
        let outputs = self.outputs(&encoded);
        self.gaussian.fit(outputs, context)
    }

    /// `log p_theta(f(o))`: the density of the network's output, not of the observation.
    fn log_prob(
        &self,
        observations: Observations<'_>,
        context: DensityContext,
    ) -> Result<Vec<f64>, MarlError> {
        self.gaussian.log_prob(self.outputs(&self.encoded(observations)?), context)
    }

    /// Numbers of outputs.
    fn features(&self) -> (usize, usize) {
        self.gaussian.features()
    }

    fn visit(&mut self, prefix: &str, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        self.gaussian.visit(prefix, visitor)
    }
}

#[cfg(test)]
mod tests {
    use libm::log;
    use policy::layers::LayerSpec;
    use policy::ops::Activation;

    use super::*;
    use crate::distribution::gaussian::LOG_TWO_PI;

    const CONTEXT: DensityContext =
        DensityContext { seed: RunSeed(0), iteration: 0, agent: 0, query: 0 };

    /// Features: 1 and 2 are scored.
    const ROWS: [f32; 12] = [
        9.0, 1.0, 1.0, //
        9.0, 1.0, -1.0, //
        8.0, -1.0, 1.0, //
        7.0, -1.0, -1.0,
    ];

    fn scored(mut density: impl Density) -> Vec<f64> {
        let observations = Observations { data: &ROWS, width: 3 };
        density.fit(observations, CONTEXT).unwrap();
        density.log_prob(observations, CONTEXT).unwrap()
    }

    /// A density of the linear map `weight`, `[2, 2]`, of the features 1 and 2.
    fn linear(weight: [f32; 4]) -> RandomEncoder {
        let mut parameters = Parameters::new();
        let spec = LayerSpec::linear("map", (2, 2), Activation::Identity, 1.0);
        let mut rng = generator(RunSeed(0), Draw::of(Purpose::Probe));
        let layers = LayerStack::declare(&mut parameters, &[spec], &mut rng).unwrap();
        parameters.set(vec![[&weight[..], &[0.0, 0.0]].concat()]).unwrap();
        RandomEncoder {
            signal: vec![1, 2],
            encoder: layers.constant_weights().unwrap(),
            gaussian: DiagonalGaussian(Moments::new(vec![0, 1])),
        }
    }

    #[test]
    fn with_the_identity_as_encoder_the_density_is_the_gaussian_of_the_observation() {
        let gaussian = DiagonalGaussian(Moments::new(vec![1, 2]));
        assert_eq!(scored(linear([1.0, 0.0, 0.0, 1.0])), scored(gaussian));
    }

    #[test]
    fn the_log_density_of_the_output_matches_a_worked_case() {
        // The outputs are sum and difference, each with mean 0 and variance 2. In every row one of them is 2 or -2 and
        // the other is 0.
        let by_hand = -log(2.0) - 1.0 - LOG_TWO_PI;
        for found in scored(linear([1.0, 1.0, 1.0, -1.0])) {
            assert!((found - by_hand).abs() < 1e-12, "{found} {by_hand}");
        }
    }

    #[test]
    fn seed_and_agent_determine_the_encoder() {
        let scores =
            |seed, agent| scored(RandomEncoder::new(vec![1, 2], (RunSeed(seed), agent)).unwrap());
        assert_eq!(scores(1, 0), scores(1, 0));
        assert_ne!(scores(1, 0), scores(2, 0));
        assert_ne!(scores(1, 0), scores(1, 1));
    }
}
