//! Hashes of small fixed computations: equal on every machine, and different for a program that computes other bits.

use std::path::Path;

use anyhow::Context as _;
use proto::Digest;
use sha2::{Digest as _, Sha256};

use crate::commands::Usage;
use crate::run_path;

/// Both hashes of this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fingerprints {
    /// Contact steps and inference; every actor must have the same one.
    pub(crate) rollout: Digest,
    /// The rollout part and one training update.
    pub(crate) learner: Digest,
}

impl Fingerprints {
    /// Computes both; takes a moment.
    pub(crate) fn measure() -> Self {
        let rollout = actor::rollout_fingerprint();
        let mut hasher = Sha256::new();
        hasher.update(rollout.0);
        hasher.update(marl::probe());
        Self { rollout, learner: Digest(hasher.finalize().into()) }
    }

    /// Refuses to resume the run in `folder` with a program that computes other bits.
    pub(crate) fn demand_those_of(&self, folder: &Path) -> anyhow::Result<()> {
        let manifest = manifest(folder)?;
        let told = |key: &str| manifest[key].as_str().unwrap_or("unknown").to_owned();
        for (key, own) in
            [("rollout_fingerprint", self.rollout), ("learner_fingerprint", self.learner)]
        {
            let (of_run, own) = (told(key), own.to_string());
            if of_run != own {
                return Err(Usage::new(format!(
                    "{} was trained by a program that computes other numbers: its {key} is {of_run}, this \
                     program's is {own}; resume it with version {}, commit {}",
                    folder.display(),
                    told("version"),
                    told("git_commit"),
                ))
                .into());
            }
        }
        Ok(())
    }
}

fn manifest(folder: &Path) -> anyhow::Result<serde_json::Value> {
    let file = run_path::manifest_file(folder);
    let shown = file.display();
    let text = std::fs::read_to_string(&file).with_context(|| format!("cannot read {shown}"))?;
    serde_json::from_str(&text).with_context(|| format!("{shown} is damaged"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_a_run_with_both_fingerprints_of_this_program_is_resumed() {
        let folder = tempfile::tempdir().unwrap();
        let here = Fingerprints { rollout: Digest([1; 32]), learner: Digest([2; 32]) };
        let resume = |rollout: u8, learner: u8| {
            let manifest = json!({
                "rollout_fingerprint": Digest([rollout; 32]).to_string(),
                "learner_fingerprint": Digest([learner; 32]).to_string(),
                "version": "0.1.0",
                "git_commit": "abc",
            });
            std::fs::write(run_path::manifest_file(folder.path()), manifest.to_string()).unwrap();
            here.demand_those_of(folder.path()).map_err(|error| error.to_string())
        };
        assert_eq!(resume(1, 2), Ok(()));
        let [other_rollout, other_learner] = [resume(3, 2), resume(1, 3)].map(Result::unwrap_err);
        assert!(other_rollout.contains("its rollout_fingerprint is 0303"), "{other_rollout}");
        assert!(other_learner.contains("its learner_fingerprint is 0303"), "{other_learner}");
        assert!(other_learner.ends_with("resume it with version 0.1.0, commit abc"));
    }
}
