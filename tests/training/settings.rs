//! Settings of a small run: 4 environments x 8 steps, two slots, small networks.

#[path = "../../marl/tests/fixture/settings.rs"]
mod small;

use std::path::Path;

use learner::config::{
    AuditConfig, CheckpointConfig, EnvironmentsConfig, EvaluationConfig, Fingerprint,
    LearnerConfig, LeaseConfig, Phase, ThreadsConfig,
};
use learner::launch::Launch;
use marl::SurpriseConfig;
use marl::config::{CriticCore, DensityKind, Rule};
use policy::{CoreKind, RunSeed};
use proto::Digest;
use serde_json::json;

use crate::hopper;

/// A new run.
pub(crate) fn launch_in(folder: &Path, iterations: u64) -> Launch {
    Launch {
        config: config(),
        training: training(),
        observations: marl::ObservationScale::AsShown,
        policy: small::policy(CoreKind::Gru),
        environment: hopper::environment(),
        task_settings: "{}".to_owned(),
        states: hopper::states(),
        divergence_remedy: String::new(),
        seed: RunSeed(7),
        iterations,
        until: iterations,
        run_id: "hopper".to_owned(),
        folder: folder.to_path_buf(),
        config_toml: "task = \"hopper-2x1\"\n".to_owned(),
        command: String::new(),
        config_sha256: Digest([1; 32]),
        build: "test".to_owned(),
        rollout_fingerprint: Digest([2; 32]),
        manifest: json!({"program": "test"}),
        resume: false,
        start: None,
        evaluations: None,
    }
}

/// The same run, resumed.
pub(crate) fn resumed(launch: Launch) -> Launch {
    Launch { resume: true, ..launch }
}

fn config() -> LearnerConfig {
    LearnerConfig {
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

/// Density and critic are those with the largest state.
fn training() -> marl::TrainingConfig {
    let mut training = small::config(Rule::Happo);
    training.critic.core = CriticCore::Gru;
    training.surprise = SurpriseConfig { alpha: 0.01, density: DensityKind::Vae };
    training.influence.lambda = 0.01;
    training.influence.holdout_every = 2;
    training
}
