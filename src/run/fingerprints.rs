//! Hashes of small fixed computations: equal on every machine, and different for a program that computes other bits.

use learner::run_folder::RunFolder;
use std::path::Path;

use proto::Digest;
use sha2::{Digest as _, Sha256};

use crate::errors::Usage;
use crate::run::run_path;

/// Version and commit of this program.
pub(crate) const BUILD: &str = concat!(env!("CARGO_PKG_VERSION"), "+", env!("S2MIA_GIT_COMMIT"));

/// Both hashes of this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fingerprints {
    /// Episodes of every task and inference; every actor must have the same one.
    pub(crate) rollout: Digest,
    /// The rollout part and one training update.
    pub(crate) learner: Digest,
}

impl Fingerprints {
    /// Computes both; takes a moment.
    pub(crate) fn measure() -> Self {
        let rollout = rollout::rollout_fingerprint();
        let mut hasher = Sha256::new();
        hasher.update(rollout.0);
        hasher.update(marl::probe());
        Self { rollout, learner: Digest(hasher.finalize().into()) }
    }

    /// Refuses to resume the run in `folder` if this program computes other bits or resolves its settings to another
    /// hash than `config`.
    pub(crate) fn demand_those_of(&self, folder: &Path, config: Digest) -> anyhow::Result<()> {
        let Some(manifest) = RunFolder::recorded(folder) else {
            // The checkpoint has the hash of its settings, too, and the learner writes the manifest again.
            let file = run_path::manifest_file(folder);
            tracing::warn!(
                "{} is missing or damaged: fingerprints are not compared",
                file.display()
            );
            return Ok(());
        };
        let told = |key: &str| manifest[key].as_str().unwrap_or("unknown").to_owned();
        let (numbers, settings) = ("computes other numbers", "has other settings");
        for (key, own, differs) in [
            ("rollout_fingerprint", self.rollout, numbers),
            ("learner_fingerprint", self.learner, numbers),
            ("config_sha256", config, settings),
        ] {
            let (of_run, own) = (told(key), own.to_string());
            if of_run != own {
                return Err(Usage::new(format!(
                    "{} was trained by a program that {differs}: its {key} is {of_run}, this \
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_a_run_with_this_programs_fingerprints_and_settings_is_resumed() {
        let folder = tempfile::tempdir().unwrap();
        let here = Fingerprints { rollout: Digest([1; 32]), learner: Digest([2; 32]) };
        let resume = |rollout: u8, learner: u8, config: u8| {
            let manifest = json!({
                "rollout_fingerprint": Digest([rollout; 32]).to_string(),
                "learner_fingerprint": Digest([learner; 32]).to_string(),
                "config_sha256": Digest([config; 32]).to_string(),
                "version": "0.1.0",
                "git_commit": "abc",
            });
            std::fs::write(run_path::manifest_file(folder.path()), manifest.to_string()).unwrap();
            let known = here.demand_those_of(folder.path(), Digest([4; 32]));
            known.map_err(|error| error.to_string())
        };
        assert_eq!(resume(1, 2, 4), Ok(()));
        for (other, named) in [
            (resume(3, 2, 4), "computes other numbers: its rollout_fingerprint is 0303"),
            (resume(1, 3, 4), "computes other numbers: its learner_fingerprint is 0303"),
            (resume(1, 2, 3), "has other settings: its config_sha256 is 0303"),
        ] {
            let refusal = other.unwrap_err();
            assert!(refusal.contains(named), "{refusal}");
            assert!(refusal.ends_with("resume it with version 0.1.0, commit abc"), "{refusal}");
        }
    }
}
