//! A fixed update whose result shows whether two machines compute the same bits.

use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};
use policy::{CoreKind, InputNorm, PolicyConfig, RefreshHidden, arrays};

use crate::config::{
    Config, Constant, CountedState, CriticConfig, CriticCore, CriticInput, CriticMode, DensityKind,
    Divergence, Estimator, Fit, InfluenceConfig, MaddpgConfig, QTraining, Reduce, Rule, Scored,
    Sharing, Space, StateNorm, SurpriseConfig, UpdateConfig, VaeConfig,
};
use crate::data::batch::{ActionKind, AgentBatch, AgentShape, Batch, Final, Problem};
use crate::error::MarlError;
use crate::optimisation::learning_rate::LearningRateDecay;
use crate::rules::build;
use crate::surprise::Surprise;

const OBSERVATION: usize = 19;
const ACTION: usize = 3;
const STATE: usize = 17;
const STEPS: usize = 20;
const ENVIRONMENTS: usize = 10;

/// SHA-256 of all weights after one small fixed update with all terms.
///
/// # Panics
/// Never: the fixed shapes are valid.
#[must_use]
pub fn probe() -> [u8; 32] {
    updated_weights().expect("the probe's fixed shapes are valid")
}

fn updated_weights() -> Result<[u8; 32], MarlError> {
    let (problem, config, batch) = (problem(), config(), batch());
    let mut surprise = Surprise::new(&config.surprise, &problem, RunSeed(0))?;
    surprise.refit(&batch, 0)?;
    let mut algorithm = build(&config, &policy(), &problem, RunSeed(0))?;
    algorithm.update(&batch, &surprise.relabel(&batch), 0)?;
    Ok(arrays::sha256(&algorithm.arrays()?))
}

pub(crate) fn problem() -> Problem {
    let shape = AgentShape {
        observation: OBSERVATION,
        action: ACTION,
        action_range: (-1.0, 1.0),
        kind: ActionKind::Continuous,
        surprise_features: (0..STATE).collect(),
        seen: vec![],
        near: vec![],
    };
    Problem { agents: vec![shape.clone(), shape], state: STATE }
}

pub(crate) fn batch() -> Batch {
    let mut rng = generator(RunSeed(0), Draw::of(Purpose::Probe).step(2));
    let rows = STEPS * ENVIRONMENTS;
    let mut normals =
        |count: usize| -> Vec<f32> { (0..count).map(|_| standard_normal(&mut rng)).collect() };
    let agents = (0..2).map(|_| AgentBatch {
        observation: normals(rows * OBSERVATION),
        action: normals(rows * ACTION),
        log_prob: vec![0.0; rows],
        hidden: normals(STEPS / policy().backpropagation_steps * ENVIRONMENTS * policy().hidden),
    });
    let agents = agents.collect();
    let finals = (0..ENVIRONMENTS).map(|environment| Final {
        step: STEPS - 1,
        environment,
        state: normals(STATE),
        observation: vec![normals(OBSERVATION), normals(OBSERVATION)],
    });
    let finals = finals.collect();
    Batch {
        steps: STEPS,
        environments: ENVIRONMENTS,
        agents,
        state: normals(rows * STATE),
        reward: normals(rows),
        terminated: vec![false; rows],
        truncated: vec![false; rows],
        finals,
    }
}

/// Settings of the probe's policies.
#[must_use]
pub fn policy() -> PolicyConfig {
    PolicyConfig {
        core: CoreKind::Gru,
        input_norm: InputNorm::LayerNorm,
        encoder: 64,
        hidden: 64,
        width: 64,
        layers: 1,
        backpropagation_steps: 10,
        burn_in: 0,
        refresh_hidden: RefreshHidden::Never,
        initial_sigma: 0.365_529_29,
        sigma_scale: 0.5,
        sigma_floor: 0.05,
        head_gain: 0.01,
    }
}

/// Settings of the probe's update, from which tests derive theirs.
#[must_use]
pub fn config() -> Config {
    Config {
        update: update(),
        critic: critic(),
        surprise: surprise(),
        influence: influence(),
        maddpg: maddpg(),
    }
}

fn update() -> UpdateConfig {
    UpdateConfig {
        rule: Rule::Happo,
        parameters: Sharing::Separate,
        gamma: 0.99,
        gae_lambda: 0.95,
        learning_rate: 5e-4,
        learning_rate_decay: LearningRateDecay::None,
        adam_epsilon: 1e-5,
        clip: 0.2,
        epochs: 2,
        minibatches: 2,
        target_kl: 0.0,
        desired_kl: 0.0,
        entropy: 0.01,
        max_gradient_norm: 10.0,
    }
}

fn critic() -> CriticConfig {
    CriticConfig {
        mode: CriticMode::PerAgent,
        input: CriticInput::State,
        core: CriticCore::Mlp,
        input_norm: InputNorm::LayerNorm,
        layers: 2,
        width: 64,
        learning_rate: 5e-4,
        epochs: 2,
        minibatches: 1,
        clip: 0.2,
        huber_delta: 10.0,
        normalizer_beta: 0.999,
        state_norm: StateNorm::None,
        max_gradient_norm: 10.0,
    }
}

pub(crate) fn surprise() -> SurpriseConfig {
    SurpriseConfig {
        alpha: 0.01,
        density: DensityKind::DiagonalGaussian,
        fit: Fit::Current,
        ema_memory: 0.9,
        space: Space::PolicyObs,
        obs: Scored::Current,
        reduce: Reduce::Sum,
        constant: Constant::Paper,
        clip: 0.0,
        feature_sigma_floor: 0.01,
        mask_below: 1e-4,
        vae: VaeConfig { hidden: 16, latent: 2, epochs: 5, minibatches: 4, learning_rate: 1e-2 },
    }
}

fn influence() -> InfluenceConfig {
    InfluenceConfig {
        lambda: 0.01,
        estimator: Estimator::VariationalKl,
        divergence: Divergence::KlQp,
        q_training: QTraining::Mle,
        kappa: 1.0,
        encoder: 32,
        hidden: 32,
        epochs: 2,
        learning_rate: 5e-4,
        minibatches: 1,
        posterior_sigma_floor: 0.05,
        holdout_every: 5,
        lag: 0,
        counted_state: CountedState::Observation,
    }
}

/// Not used by the probe's rule.
fn maddpg() -> MaddpgConfig {
    MaddpgConfig {
        replay: 1000,
        batch: 10,
        n_step: 1,
        warm_up: 0,
        updates_per_step: 0.1,
        noise: 0.1,
        polyak: 0.005,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_probe_gives_the_same_bits_on_pools_of_one_two_and_three_threads() {
        let on = |threads: usize| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("thread pool")
                .install(probe)
        };
        assert_eq!(on(1), on(2));
        assert_eq!(on(1), on(3));
    }
}
