//! What tells whether two machines compute the same bits: hashes of fixed small computations.

use std::path::Path;

use anyhow::Context as _;
use proto::Digest;
use sha2::{Digest as _, Sha256};

use crate::commands::Usage;
use crate::run_path;

/// Both hashes of this program on this machine.
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

    /// What a resume on this machine makes of the run in `folder`.
    pub(crate) fn compare(&self, folder: &Path) -> anyhow::Result<Kinship> {
        let manifest = manifest(folder)?;
        let told = |key: &str| manifest[key].as_str().unwrap_or_default().to_owned();
        let same = told("rollout_fingerprint") == self.rollout.to_string()
            && told("learner_fingerprint") == self.learner.to_string();
        Ok(match (same, manifest[ONE_KIND].as_bool()) {
            (true, Some(true)) => Kinship::Exact,
            (true, _) => Kinship::Mixed,
            (false, _) => Kinship::Foreign,
        })
    }
}

/// The manifest's field that says whether all of a run was computed with the same bits.
pub(crate) const ONE_KIND: &str = "one_machine_kind";

/// How a run's past relates to this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kinship {
    /// All of it has the same bits as here.
    Exact,
    /// The last part has, an earlier one has not.
    Mixed,
    /// The last part has other bits.
    Foreign,
}

impl Kinship {
    /// Refuses a run of another machine, unless that is allowed.
    pub(crate) fn demand(self, folder: &Path) -> Result<(), Usage> {
        match self {
            Self::Exact | Self::Mixed => Ok(()),
            Self::Foreign => Err(Usage::new(format!(
                "{} was computed with other last bits (another processor or program), so going on \
                 here is not exact; pass --allow-other-machine to go on all the same",
                folder.display()
            ))),
        }
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
    fn a_run_once_continued_elsewhere_is_never_exact_again() {
        let folder = tempfile::tempdir().unwrap();
        let here = Fingerprints { rollout: Digest([1; 32]), learner: Digest([2; 32]) };
        let compare = |learner: Digest, one_kind: bool| {
            let manifest = json!({
                "rollout_fingerprint": here.rollout.to_string(),
                "learner_fingerprint": learner.to_string(),
                ONE_KIND: one_kind,
            });
            std::fs::write(run_path::manifest_file(folder.path()), manifest.to_string()).unwrap();
            here.compare(folder.path()).unwrap()
        };
        assert_eq!(compare(here.learner, true), Kinship::Exact);
        assert_eq!(compare(here.learner, false), Kinship::Mixed);
        assert_eq!(compare(Digest([3; 32]), true), Kinship::Foreign);
    }

    #[test]
    fn only_a_foreign_run_is_refused() {
        let folder = Path::new("runs/a");
        assert!(Kinship::Exact.demand(folder).is_ok() && Kinship::Mixed.demand(folder).is_ok());
        let message = Kinship::Foreign.demand(folder).unwrap_err().to_string();
        assert!(message.contains("--allow-other-machine"), "{message}");
    }
}
