//! Reads and checks certificates, keys and authorities in PEM files.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rustls::crypto::{CryptoProvider, ring};
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::sign::CertifiedKey;
use rustls::{Error, RootCertStore};

use crate::error::SecurityError;
use crate::validity::{Moment, Validity};

const CERTIFICATE: &str = "certificate";
const PRIVATE_KEY: &str = "private key";

/// Files of a certificate with its chain, and of its private key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdentityFiles {
    /// PEM file of the certificate, then the rest of its chain.
    pub certificate: PathBuf,
    /// PEM file of its private key.
    pub key: PathBuf,
}

/// The provider of all cryptography.
pub(crate) fn provider() -> CryptoProvider {
    ring::default_provider()
}

pub(crate) fn read(path: &Path) -> Result<Vec<u8>, SecurityError> {
    std::fs::read(path).map_err(|error| SecurityError::Unreadable {
        path: path.to_path_buf(),
        why: error.to_string(),
    })
}

/// The certificates in `pem`, which was read from `path`: at least one; the first is valid at `now`.
pub(crate) fn certificates(
    path: &Path,
    pem: &[u8],
    now: SystemTime,
) -> Result<Vec<CertificateDer<'static>>, SecurityError> {
    let found = CertificateDer::pem_slice_iter(pem).collect::<Result<Vec<_>, _>>();
    let chain = found.ok().filter(|chain| !chain.is_empty());
    let chain = chain.ok_or_else(|| not_pem(path, CERTIFICATE))?;
    demand_validity(path, &chain[0], now)?;
    Ok(chain)
}

/// Refuses a certificate, read from `path`, that is not valid at `now`; returns the end of its validity.
pub(crate) fn demand_validity(
    path: &Path,
    certificate: &CertificateDer<'_>,
    now: SystemTime,
) -> Result<Moment, SecurityError> {
    let validity = Validity::of(certificate)
        .ok_or_else(|| unusable(path, CERTIFICATE, "it is damaged".to_owned()))?;
    let (path, now) = (path.to_path_buf(), Moment::from(now));
    if now > validity.until {
        let (at, now) = (validity.until.to_string(), now.to_string());
        return Err(SecurityError::Expired { path, at, now });
    }
    if now < validity.from {
        let (at, now) = (validity.from.to_string(), now.to_string());
        return Err(SecurityError::NotYetValid { path, at, now });
    }
    Ok(validity.until)
}

/// The authorities in `pem`, which was read from `path`.
pub(crate) fn authorities(
    path: &Path,
    pem: &[u8],
    now: SystemTime,
) -> Result<RootCertStore, SecurityError> {
    let mut roots = RootCertStore::empty();
    for certificate in certificates(path, pem, now)? {
        roots.add(certificate).map_err(|error| unusable(path, CERTIFICATE, error.to_string()))?;
    }
    Ok(roots)
}

/// A certificate and its key from the contents of both files.
pub(crate) fn certified_key(
    files: &IdentityFiles,
    certificate_pem: &[u8],
    key_pem: &[u8],
    now: SystemTime,
) -> Result<CertifiedKey, SecurityError> {
    let chain = certificates(&files.certificate, certificate_pem, now)?;
    // The parser's message may quote the file, so it is not passed on.
    let key =
        PrivateKeyDer::from_pem_slice(key_pem).map_err(|_| not_pem(&files.key, PRIVATE_KEY))?;
    CertifiedKey::from_der(chain, key, &provider()).map_err(|error| match error {
        Error::InconsistentKeys(_) => SecurityError::OtherKey {
            certificate: files.certificate.clone(),
            key: files.key.clone(),
        },
        error => unusable(&files.key, PRIVATE_KEY, error.to_string()),
    })
}

fn not_pem(path: &Path, expected: &'static str) -> SecurityError {
    SecurityError::NotPem { path: path.to_path_buf(), expected }
}

pub(crate) fn unusable(path: &Path, what: &'static str, why: String) -> SecurityError {
    SecurityError::Unusable { path: path.to_path_buf(), what, why }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::development::{Issued, Issuer};
    use crate::role::Role;

    const DAY: Duration = Duration::from_secs(86_400);

    fn files() -> IdentityFiles {
        IdentityFiles { certificate: "own.pem".into(), key: "own.key".into() }
    }

    fn issued(from: SystemTime) -> Issued {
        Issuer::new(from, DAY).and_then(|issuer| issuer.client(Role::Actor)).unwrap()
    }

    fn refusal(certificate: &str, key: &str, now: SystemTime) -> String {
        let read = certified_key(&files(), certificate.as_bytes(), key.as_bytes(), now);
        read.map(|_| "accepted").unwrap_err().to_string()
    }

    #[test]
    fn what_is_wrong_with_a_file_is_one_line_that_never_quotes_a_key() {
        let now = SystemTime::now();
        let (own, other) = (issued(now), issued(now));
        let cut = &own.key[..own.key.len() / 2];
        for (certificate, key, line) in [
            ("", own.key.as_str(), "own.pem holds no certificate in PEM form"),
            (&own.key, &own.key, "own.pem holds no certificate in PEM form"),
            (&own.certificate, "", "own.key holds no private key in PEM form"),
            (&own.certificate, cut, "own.key holds no private key in PEM form"),
            (
                &own.certificate,
                &other.key,
                "the private key own.key does not fit the certificate own.pem",
            ),
        ] {
            assert_eq!(refusal(certificate, key, now), line);
        }
        let damaged = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
        assert!(refusal(damaged, &own.key, now).contains("it is damaged"));
    }

    #[test]
    fn a_certificate_is_refused_before_its_first_and_after_its_last_moment() {
        let now = SystemTime::now();
        let own = issued(now);
        let late = refusal(&own.certificate, &own.key, now + 2 * DAY);
        assert!(late.starts_with("the certificate own.pem expired at "), "{late}");
        let early = refusal(&own.certificate, &own.key, now - 2 * DAY);
        assert!(early.starts_with("the certificate own.pem is valid from "), "{early}");
        let (certificate, key) = (own.certificate.as_bytes(), own.key.as_bytes());
        assert!(certified_key(&files(), certificate, key, now).is_ok());
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = read(Path::new("no/such.pem")).unwrap_err().to_string();
        assert!(error.starts_with("cannot read no/such.pem: "), "{error}");
    }
}
