//! A fixed computation whose hash shows whether two machines compute the same bits.

use candle_core::DType;
use sha2::{Digest, Sha256};

use crate::acting::{ActorPolicy, Scratch};
use crate::config::{CoreKind, InputNorm, PolicyConfig, RefreshHidden};
use crate::error::PolicyError;
use crate::network::ActorNetwork;
use crate::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};

const OBSERVATION: usize = 19;
const ACTION: usize = 3;
const STEPS: usize = 100;

/// SHA-256 over the bits of 100 steps of a fixed recurrent policy on fixed observations.
///
/// # Panics
/// Never: the shapes are fixed and fit.
#[must_use]
pub fn probe() -> [u8; 32] {
    let policy = fixed_policy().expect("the probe's fixed shapes fit");
    let mut rng = generator(RunSeed(0), Draw::of(Purpose::Probe).step(1));
    let mut hidden = vec![0.0; policy.hidden_size()];
    let (mut mean, mut scratch) = ([0.0; ACTION], Scratch::default());
    let mut hash = Sha256::new();
    for _ in 0..STEPS {
        let observation: Vec<f32> = (0..OBSERVATION).map(|_| standard_normal(&mut rng)).collect();
        policy.forward(1, &observation, &mut hidden, &mut mean, &mut scratch);
        let log_prob = crate::gaussian::log_prob(&mean, policy.sigma(), &[0.1, -0.2, 0.3]);
        for number in mean.iter().chain(&hidden).chain([&log_prob]) {
            hash.update(number.to_le_bytes());
        }
    }
    hash.finalize().into()
}

fn fixed_policy() -> Result<ActorPolicy, PolicyError> {
    let config = PolicyConfig {
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
        head_gain: 1.0,
    };
    let mut rng = generator(RunSeed(0), Draw::of(Purpose::Probe));
    ActorNetwork::new(&config, OBSERVATION, ACTION, DType::F32, &mut rng)?.policy()
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_probe_is_deterministic() {
        assert_eq!(super::probe(), super::probe());
    }
}
