//! A fixed computation whose hash shows whether two machines compute the same bits.

use sha2::{Digest, Sha256};

use crate::acting::{ActorPolicy, Scratch};
use crate::config::{CoreKind, InputNorm, PolicyConfig};
use crate::error::PolicyError;
use crate::head::Head;
use crate::network::ActorNetwork;
use crate::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};

const OBSERVATION: usize = 19;
const ACTION: usize = 3;
const STEPS: usize = 100;

/// SHA-256 over the bits of 100 steps of fixed policies of both kinds, with continuous and discrete actions, on fixed
/// observations.
///
/// # Panics
/// Never: the shapes are fixed and fit.
#[must_use]
pub fn probe() -> [u8; 32] {
    let mut hash = Sha256::new();
    let choices = Head::Categorical { choices: ACTION };
    for (core, head, action) in [
        (CoreKind::Gru, Head::Gaussian, ACTION),
        (CoreKind::Mlp, Head::Gaussian, ACTION),
        (CoreKind::Gru, choices, 1),
        (CoreKind::Mlp, choices, 1),
    ] {
        let policy = fixed_policy(core, head, action).expect("the probe's fixed shapes fit");
        act(&policy, &mut hash);
    }
    hash.finalize().into()
}

/// Adds the bits of 100 steps of the policy.
fn act(policy: &ActorPolicy, hash: &mut Sha256) {
    let mut rng = generator(RunSeed(0), Draw::of(Purpose::Probe).step(1));
    let mut hidden = vec![0.0; policy.hidden_size()];
    let mut output = vec![0.0; policy.output_size()];
    let mut action = vec![0.0; policy.action_size()];
    let mut scratch = Scratch::default();
    for _ in 0..STEPS {
        let observation: Vec<f32> = (0..OBSERVATION).map(|_| standard_normal(&mut rng)).collect();
        policy.forward(1, &observation, &mut hidden, &mut output, &mut scratch);
        policy.draw(&output, &mut rng, &mut action);
        let log_prob = policy.log_prob(&output, &action);
        for number in output.iter().chain(&hidden).chain(&action).chain([&log_prob]) {
            hash.update(number.to_le_bytes());
        }
    }
}

fn fixed_policy(core: CoreKind, head: Head, action: usize) -> Result<ActorPolicy, PolicyError> {
    let mut rng = generator(RunSeed(0), Draw::of(Purpose::Probe));
    ActorNetwork::new(&config(core), OBSERVATION, action, head, &mut rng)?.policy()
}

/// Settings of the probe's policies, from which tests derive theirs.
#[must_use]
pub fn config(core: CoreKind) -> PolicyConfig {
    PolicyConfig {
        core,
        input_norm: InputNorm::LayerNorm,
        encoder: 64,
        hidden: 64,
        width: 64,
        layers: 1,
        backpropagation_steps: 10,
        sigma_scale: 0.5,
        sigma_floor: 0.05,
        head_gain: 1.0,
        noise: None,
        noise_size: None,
        noise_hold: None,
        noise_loading: None,
        noise_decay_steps: None,
    }
}
