//! Roles in certificates, and the calls that each role permits.

use std::fmt;

use rustls::pki_types::CertificateDer;
use webpki::EndEntityCert;

/// Prefix of a role in an alternative name (URI) of a certificate.
const URI_PREFIX: &str = "s2mia://role/";

/// The role of a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Rolls out: all calls of `LearnerService`.
    Actor,
    /// Watches and stops runs, uses policies: all other calls.
    Operator,
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 2] = [Self::Actor, Self::Operator];

    /// Name of the role.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Actor => "actor",
            Self::Operator => "operator",
        }
    }

    /// The role as an alternative name (URI) of a certificate.
    #[must_use]
    pub fn uri(self) -> String {
        format!("{URI_PREFIX}{}", self.name())
    }

    /// The roles in a verified certificate.
    fn in_certificate(certificate: &CertificateDer<'_>) -> Vec<Self> {
        let Ok(certificate) = EndEntityCert::try_from(certificate) else { return Vec::new() };
        let names = certificate.valid_uri_names().collect::<Vec<_>>();
        Self::ALL.into_iter().filter(|role| names.contains(&role.uri().as_str())).collect()
    }
}

impl fmt::Display for Role {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// Permissions of the peer of a connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Permissions {
    /// All calls: the connection is not authenticated.
    All,
    /// The calls that these roles permit.
    Roles(Vec<Role>),
}

/// A call that the peer's roles do not permit.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this call needs the role {needed}; the certificate carries {}", listed(.held))]
pub struct Denied {
    /// The required role.
    pub needed: Role,
    /// The roles of the certificate.
    pub held: Vec<Role>,
}

fn listed(roles: &[Role]) -> String {
    match roles {
        [] => "no role".to_owned(),
        roles => roles.iter().map(|role| role.name()).collect::<Vec<_>>().join(", "),
    }
}

impl Permissions {
    /// Permissions of a peer with this chain of certificates, its own first.
    #[must_use]
    pub fn of_chain(chain: Option<&[CertificateDer<'_>]>) -> Self {
        let own = chain.and_then(|chain| chain.first());
        Self::Roles(own.map(Role::in_certificate).unwrap_or_default())
    }

    /// Refuses a call that requires a role that the peer does not have.
    ///
    /// # Errors
    /// Names the required role and the peer's roles.
    pub fn demand(&self, needed: Role) -> Result<(), Denied> {
        match self {
            Self::All => Ok(()),
            Self::Roles(held) if held.contains(&needed) => Ok(()),
            Self::Roles(held) => Err(Denied { needed, held: held.clone() }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_role_permits_its_own_calls_only() {
        for needed in Role::ALL {
            for held in Role::ALL {
                let allowed = Permissions::Roles(vec![held]).demand(needed).is_ok();
                assert_eq!(allowed, held == needed, "{held} as {needed}");
            }
            assert!(Permissions::Roles(Role::ALL.to_vec()).demand(needed).is_ok());
            assert!(Permissions::All.demand(needed).is_ok());
            assert!(Permissions::of_chain(None).demand(needed).is_err());
        }
    }

    #[test]
    fn a_denial_names_the_role_needed_and_those_held() {
        let denied = Permissions::Roles(vec![Role::Operator]).demand(Role::Actor).unwrap_err();
        let line = "this call needs the role actor; the certificate carries operator";
        assert_eq!(denied.to_string(), line);
        let denied = Permissions::Roles(vec![]).demand(Role::Operator).unwrap_err();
        assert!(denied.to_string().ends_with("the certificate carries no role"));
    }
}
