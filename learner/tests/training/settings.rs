//! Settings of a small run: 4 environments x 8 steps, two slots, small networks.

use std::path::Path;

use learner::config::{
    AuditConfig, CheckpointConfig, Config, EnvironmentsConfig, EvaluationConfig, Fingerprint,
    LeaseConfig, Phase, ThreadsConfig,
};
use learner::launch::Launch;
use policy::{CoreKind, InputNorm, PolicyConfig, RunSeed};
use proto::Digest;
use serde_json::json;

use crate::toy;

/// A new run.
pub(crate) fn launch_in(folder: &Path, iterations: u64) -> Launch {
    Launch {
        config: config(),
        training: training(),
        observations: marl::ObservationScale::AsShown,
        policy: policy(),
        environment: toy::environment(),
        task_settings: "{}".to_owned(),
        states: toy::states(),
        divergence_remedy: String::new(),
        seed: RunSeed(7),
        iterations,
        run_id: "toy".to_owned(),
        folder: folder.to_path_buf(),
        config_toml: "task = \"toy\"\n".to_owned(),
        config_sha256: Digest([1; 32]),
        build: "test".to_owned(),
        rollout_fingerprint: Digest([2; 32]),
        manifest: json!({"program": "test"}),
        resume: false,
    }
}

/// The same run, resumed.
pub(crate) fn resumed(launch: Launch) -> Launch {
    Launch { resume: true, ..launch }
}

fn config() -> Config {
    Config {
        environments: EnvironmentsConfig {
            count: 4,
            steps: 8,
            per_slot: 2,
            message_steps: 4,
            phase: Phase::Staggered,
        },
        lease: LeaseConfig { ttl_secs: 20.0 },
        audit: AuditConfig { share: 0.5, fingerprint: Fingerprint::Optional },
        evaluation: EvaluationConfig { every_steps: 64, episodes: 3, sampled: false },
        checkpoint: CheckpointConfig { every: 2, keep_last: 3 },
        learner: ThreadsConfig { threads: 2, connections: 16, other_builds: false },
    }
}

fn policy() -> PolicyConfig {
    PolicyConfig {
        core: CoreKind::Gru,
        input_norm: InputNorm::LayerNorm,
        encoder: 8,
        hidden: 8,
        width: 8,
        layers: 1,
        backpropagation_steps: 2,
        sigma_scale: 0.5,
        sigma_floor: 0.05,
        head_gain: 0.01,
    }
}

/// Parsed from JSON, so that the test does not depend on all types of the settings. Density and critic are those with
/// the largest state.
fn training() -> marl::Config {
    serde_json::from_value(json!({
        "update": {
            "rule": "happo", "parameters": "separate", "gamma": 0.99, "gae_lambda": 0.95, "learning_rate": 5e-4,
            "learning_rate_decay": "none",
            "adam_epsilon": 1e-5, "clip": 0.2, "epochs": 2, "minibatches": 1, "desired_kl": 0.0, "entropy": 0.0,
            "max_gradient_norm": 10.0,
        },
        "critic": {
            "core": "gru", "input_norm": "layer_norm", "layers": 1, "width": 8, "learning_rate": 5e-4, "epochs": 2,
            "minibatches": 1, "clip": 0.2, "huber_delta": 10.0, "normalizer_beta": 0.999,
            "state_norm": "none", "max_gradient_norm": 10.0,
        },
        "surprise": {
            "alpha": 0.01, "density": "vae",
        },
        "influence": {
            "lambda": 0.01, "estimator": "variational_kl",
            "q_training": "mle", "kappa": 1.0, "encoder": 8, "hidden": 8, "epochs": 2,
            "learning_rate": 5e-4, "minibatches": 1, "posterior_sigma_floor": 0.05, "holdout_every": 2,
            "lag": 0,
        },
        "maddpg": {
            "replay": 1000, "batch": 8, "n_step": 2, "warm_up": 0, "updates_per_step": 0.1,
            "noise": 0.1, "polyak": 0.005,
        },
    }))
    .unwrap()
}
