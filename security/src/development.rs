//! A certificate authority for development and tests, and the certificates that it signs. An existing authority can be
//! used instead if its certificates carry a role.

use std::time::{Duration, SystemTime};

use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DistinguishedName, DnType,
    ExtendedKeyUsagePurpose, IsCa, KeyPair, KeyUsagePurpose, SanType, date_time_ymd,
};

use crate::error::SecurityError;
use crate::role::Role;

/// Clocks of two machines may differ by this much.
const CLOCK_SKEW: Duration = Duration::from_secs(300);

/// A certificate and its private key, both in PEM form.
pub struct Issued {
    /// The certificate.
    pub certificate: String,
    /// Its private key: a secret.
    pub key: String,
}

/// A certificate authority. Its key exists in memory only.
pub struct Issuer {
    authority: CertifiedIssuer<'static, KeyPair>,
    from: SystemTime,
    duration: Duration,
}

impl Issuer {
    /// A new authority; its certificate and those that it signs are valid for `duration` after `from`.
    ///
    /// # Errors
    /// The certificate cannot be created.
    pub fn new(from: SystemTime, duration: Duration) -> Result<Self, SecurityError> {
        let mut params = params("s2mia development authority", from, duration);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let key = KeyPair::generate().map_err(unmakeable)?;
        let authority = CertifiedIssuer::self_signed(params, key).map_err(unmakeable)?;
        Ok(Self { authority, from, duration })
    }

    /// The authority's own certificate in PEM form.
    #[must_use]
    pub fn certificate(&self) -> String {
        self.authority.pem()
    }

    /// A learner's certificate for these host names and IP addresses.
    ///
    /// # Errors
    /// A name is invalid.
    pub fn server(&self, names: &[String]) -> Result<Issued, SecurityError> {
        let mut params = params("s2mia learner", self.from, self.duration);
        let named = CertificateParams::new(names).map_err(unmakeable)?;
        params.subject_alt_names = named.subject_alt_names;
        self.issue(params, ExtendedKeyUsagePurpose::ServerAuth)
    }

    /// A client's certificate that carries these roles; without any, it permits nothing.
    ///
    /// # Errors
    /// The certificate cannot be created.
    pub fn client(&self, roles: &[Role]) -> Result<Issued, SecurityError> {
        let mut params = params("s2mia client", self.from, self.duration);
        for role in roles {
            let uri = role.uri().try_into().map_err(unmakeable)?;
            params.subject_alt_names.push(SanType::URI(uri));
        }
        self.issue(params, ExtendedKeyUsagePurpose::ClientAuth)
    }

    fn issue(
        &self,
        mut params: CertificateParams,
        purpose: ExtendedKeyUsagePurpose,
    ) -> Result<Issued, SecurityError> {
        params.extended_key_usages = vec![purpose];
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        let key = KeyPair::generate().map_err(unmakeable)?;
        let certificate = params.signed_by(&key, &self.authority).map_err(unmakeable)?;
        Ok(Issued { certificate: certificate.pem(), key: key.serialize_pem() })
    }
}

fn params(name: &str, from: SystemTime, duration: Duration) -> CertificateParams {
    let mut params = CertificateParams::default();
    let mut subject = DistinguishedName::new();
    subject.push(DnType::CommonName, name);
    let begin = from.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let epoch = date_time_ymd(1970, 1, 1);
    params.distinguished_name = subject;
    params.not_before = epoch + begin.saturating_sub(CLOCK_SKEW);
    params.not_after = epoch + begin + duration;
    params
}

fn unmakeable(error: rcgen::Error) -> SecurityError {
    SecurityError(format!("cannot make a certificate: {error}"))
}
