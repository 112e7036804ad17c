//! The twin critics: action values of the joint action in a global state, without target networks.

use policy::randomness::{Draw, Purpose, RunSeed, generator};
use rayon::prelude::*;

use crate::config::{HasacConfig, TrainingConfig};
use crate::critic::StateScale;
use crate::data::batch::Problem;
use crate::error::MarlError;
use crate::rules::hasac::network::{FrozenNetwork, NormalisedNetwork};
use crate::state::Visitor;

/// Two critics with different initial weights; the smaller of their values counts.
pub(super) struct TwinCritics {
    networks: Vec<NormalisedNetwork>,
    states: StateScale,
    /// Size of the state.
    features: usize,
}

/// Metrics of one optimiser step, means over both critics.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CriticMetrics {
    pub(super) value_loss: f64,
    pub(super) gradient_norm: f64,
}

impl TwinCritics {
    pub(super) fn new(
        (config, own): (&TrainingConfig, &HasacConfig),
        problem: &Problem,
        seed: RunSeed,
    ) -> Result<Self, MarlError> {
        let critic = &config.critic;
        let actions: usize = problem.agents.iter().map(|agent| agent.action).sum();
        let adam = critic.adam(config.update.adam_epsilon);
        let network = |twin: u32| {
            let mut rng = generator(seed, Draw::of(Purpose::CriticInitialisation).agent(twin));
            let sizes = (problem.state + actions, critic.width, critic.layers, 1);
            NormalisedNetwork::new(sizes, (adam, own), &mut rng)
        };
        Ok(Self {
            networks: (0..2).map(network).collect::<Result<_, _>>()?,
            states: StateScale::new(critic.state_norm, problem.state),
            features: problem.state,
        })
    }

    /// Width `S + A` of a joint input.
    pub(super) fn inputs(&self) -> usize {
        self.networks[0].inputs()
    }

    /// Scales states `[R, S]` for [`Self::joint_input`].
    pub(super) fn scale(&self, state: &mut [f32]) {
        self.states.apply(state, self.features);
    }

    /// Scaled states `[R, S]` joined with all agents' actions `[N][R, act]`: `[R, S + A]`.
    pub(super) fn joint_input(&self, state: &[f32], actions: &[&[f32]]) -> Vec<f32> {
        let rows = state.len() / self.features;
        let mut input = Vec::new();
        for (row, state) in state.chunks_exact(self.features).enumerate() {
            input.extend_from_slice(state);
            for action in actions {
                let width = action.len() / rows;
                input.extend_from_slice(&action[row * width..(row + 1) * width]);
            }
        }
        input
    }

    /// One descent step of both critics on the mean squared error of the first half of the rows, whose targets follow
    /// from the values of the second half, `[2][R]`: one pass, so that batch norms see both halves.
    pub(super) fn fit(
        &mut self,
        input: &[f32],
        targets: impl FnOnce([&[f32]; 2]) -> Vec<f64>,
    ) -> Result<CriticMetrics, MarlError> {
        let values = self.networks.par_iter_mut().map(|network| network.forward(input));
        let values = values.collect::<Result<Vec<_>, _>>()?;
        let rows = values[0].len() / 2;
        let targets = targets([&values[0][rows..], &values[1][rows..]]);
        let share = 1.0 / rows as f64;
        let steps = self.networks.par_iter_mut().zip(&values).map(|(network, values)| {
            let pairs = values.iter().zip(&targets);
            let errors: Vec<f64> = pairs.map(|(&value, y)| f64::from(value) - y).collect();
            let mut gradient: Vec<f32> =
                errors.iter().map(|error| (2.0 * share * error) as f32).collect();
            gradient.resize(2 * rows, 0.0);
            let gradient_norm = network.descend(&gradient)?;
            let value_loss = share * errors.iter().map(|error| error * error).sum::<f64>();
            Ok(CriticMetrics { value_loss, gradient_norm })
        });
        let steps = steps.collect::<Result<Vec<_>, MarlError>>()?;
        let mean = |part: fn(&CriticMetrics) -> f64| 0.5 * steps.iter().map(part).sum::<f64>();
        Ok(CriticMetrics {
            value_loss: mean(|step| step.value_loss),
            gradient_norm: mean(|step| step.gradient_norm),
        })
    }

    /// The critics with their running statistics, for reading.
    pub(super) fn frozen(&self) -> Result<FrozenCritics, MarlError> {
        let twins = self.networks.par_iter().map(NormalisedNetwork::frozen);
        Ok(FrozenCritics(twins.collect::<Result<_, _>>()?))
    }

    pub(super) fn scale_learning_rates(&mut self, share: f64) {
        self.networks.iter_mut().for_each(|network| network.scale_learning_rate(share));
    }

    pub(super) fn skipped(&self) -> i64 {
        self.networks.iter().map(NormalisedNetwork::skipped).sum()
    }

    /// Visits the arrays of `q_0` and `q_1`.
    pub(super) fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
        let mut twins = self.networks.iter_mut().enumerate();
        twins.try_for_each(|(twin, network)| network.visit(&format!("q_{twin}"), visitor))
    }
}

/// Twin critics that are only read.
pub(super) struct FrozenCritics(Vec<FrozenNetwork>);

impl FrozenCritics {
    /// The smaller of both values of every row, `[R]`, and its gradient with respect to the joint input, `[R, S + A]`.
    pub(super) fn smaller(&mut self, input: &[f32]) -> (Vec<f64>, Vec<f32>) {
        let values: Vec<Vec<f32>> = self.0.par_iter_mut().map(|twin| twin.forward(input)).collect();
        let chosen = |twin: usize, row: usize| {
            let first = values[0][row] <= values[1][row];
            if first == (twin == 0) { 1.0 } else { 0.0 }
        };
        let rows = values[0].len();
        let gradient = |(twin, network): (usize, &mut FrozenNetwork)| {
            let output: Vec<f32> = (0..rows).map(|row| chosen(twin, row)).collect();
            network.input_gradient(&output)
        };
        let gradients: Vec<Vec<f32>> = self.0.par_iter_mut().enumerate().map(gradient).collect();
        let sum = gradients[0].iter().zip(&gradients[1]).map(|(x, y)| x + y).collect();
        let pairs = values[0].iter().zip(&values[1]);
        (pairs.map(|(&x, &y)| f64::from(if x <= y { x } else { y })).collect(), sum)
    }
}
