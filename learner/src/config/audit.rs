//! Settings of audits.

use policy::setting::{SettingError, between};
use serde::{Deserialize, Serialize};

/// How many slots and evaluation episodes are computed twice, by two actors, to compare the results, and whether actors
/// that cannot be compared get work.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuditConfig {
    /// Share of the slots and episodes, 0 to 1. Nothing is audited while the actors of fewer than two processes are
    /// connected.
    pub share: f64,
    /// Whether actors without the run's rollout fingerprint, which promises equal results, get work.
    pub fingerprint: Fingerprint,
}

/// Whether actors without the run's rollout fingerprint get work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fingerprint {
    /// They do not if the run starts its own actors, or if everything is audited.
    Auto,
    /// They do not.
    Required,
    /// They do.
    Optional,
}

impl AuditConfig {
    /// The settings of a run that starts its own actors, which all have the fingerprint.
    #[must_use]
    pub fn with_own_actors(self) -> Self {
        match self.fingerprint {
            Fingerprint::Auto => Self { fingerprint: Fingerprint::Required, ..self },
            Fingerprint::Required | Fingerprint::Optional => self,
        }
    }

    /// Whether actors without the run's rollout fingerprint get no work.
    #[must_use]
    pub fn requires_fingerprint(self) -> bool {
        match self.fingerprint {
            Fingerprint::Auto => self.share >= 1.0,
            Fingerprint::Required => true,
            Fingerprint::Optional => false,
        }
    }

    /// Refuses shares outside 0 to 1.
    ///
    /// # Errors
    /// Names the key and its range.
    pub fn validate(&self) -> Result<(), SettingError> {
        between("audit.share", self.share, 0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_actor_without_a_fingerprint_needs_permission_where_all_others_have_one_or_all_is_audited()
    {
        let requires = |share, fingerprint| {
            let audit = AuditConfig { share, fingerprint };
            (audit.requires_fingerprint(), audit.with_own_actors().requires_fingerprint())
        };
        assert_eq!(requires(0.01, Fingerprint::Auto), (false, true));
        assert_eq!(requires(1.0, Fingerprint::Auto), (true, true));
        assert_eq!(requires(0.0, Fingerprint::Required), (true, true));
        assert_eq!(requires(1.0, Fingerprint::Optional), (false, false));
    }
}
