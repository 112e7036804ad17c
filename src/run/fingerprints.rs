//! Which program may resume a run: one that computes the same bits and resolves the same settings.

use std::path::Path;

use learner::store::run_folder::RunFolder;
use proto::Digest;

use crate::errors::Usage;
use crate::run::run_path;

/// Version and commit of this program.
pub(crate) const BUILD: &str = concat!(env!("CARGO_PKG_VERSION"), "+", env!("S2MIA_GIT_COMMIT"));

/// Refuses to resume the run in `folder` if this program, whose fingerprint is `rollout`, computes other bits or resolves
/// its settings to another hash than `config`.
pub(crate) fn demand_those_of(
    folder: &Path,
    rollout: Digest,
    config: Digest,
) -> anyhow::Result<()> {
    let Some(manifest) = RunFolder::recorded(folder) else {
        // The checkpoint has the hash of its settings, too, and the learner writes the manifest again.
        let file = run_path::manifest_file(folder);
        tracing::warn!("{} is missing or damaged: fingerprints are not compared", file.display());
        return Ok(());
    };
    let recorded = |key: &str| manifest[key].as_str().unwrap_or("unknown").to_owned();
    for (key, own, differs) in [
        ("rollout_fingerprint", rollout, "computes other numbers"),
        ("config_sha256", config, "has other settings"),
    ] {
        let (of_run, own) = (recorded(key), own.to_string());
        if of_run != own {
            return Err(Usage::new(format!(
                "{} was trained by a program that {differs}: its {key} is {of_run}, this \
                 program's is {own}; resume it with version {}, commit {}",
                folder.display(),
                recorded("version"),
                recorded("git_commit"),
            ))
            .into());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_a_run_with_this_programs_fingerprint_and_settings_is_resumed() {
        let resume = |rollout: u8, config: u8| {
            let manifest = json!({
                "rollout_fingerprint": Digest([rollout; 32]).to_string(),
                "config_sha256": Digest([config; 32]).to_string(),
                "version": "0.1.0",
                "git_commit": "abc",
            });
            let folder = tempfile::tempdir().unwrap();
            RunFolder::claim_new(folder.path()).unwrap().begin("", &manifest).unwrap();
            let known = demand_those_of(folder.path(), Digest([1; 32]), Digest([4; 32]));
            known.map_err(|error| error.to_string())
        };
        assert_eq!(resume(1, 4), Ok(()));
        for (other, named) in [
            (resume(3, 4), "computes other numbers: its rollout_fingerprint is 0303"),
            (resume(1, 3), "has other settings: its config_sha256 is 0303"),
        ] {
            let refusal = other.unwrap_err();
            assert!(refusal.contains(named), "{refusal}");
            assert!(refusal.ends_with("resume it with version 0.1.0, commit abc"), "{refusal}");
        }
    }
}
