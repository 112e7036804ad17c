//! Reads and checks certificates, keys and authorities in PEM files.

use std::fmt::Display;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use rustls::crypto::{CryptoProvider, ring};
use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, UnixTime};
use rustls::sign::CertifiedKey;
use rustls::{Error, RootCertStore};
use time::OffsetDateTime;
use webpki::{EndEntityCert, KeyUsage};

use crate::error::SecurityError;

/// More bytes than any chain of certificates or key has.
const MOST_BYTES: u64 = 1 << 20;
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
    let unreadable =
        |why: &dyn Display| SecurityError(format!("cannot read {}: {why}", path.display()));
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|error| unreadable(&error))?;
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(|error| unreadable(&error))?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(unreadable(&format!("it has more than {MOST_BYTES} bytes")));
    }
    Ok(bytes)
}

/// The certificates in `pem`, which was read from `path`: at least one.
fn certificates(path: &Path, pem: &[u8]) -> Result<Vec<CertificateDer<'static>>, SecurityError> {
    let found = CertificateDer::pem_slice_iter(pem).collect::<Result<Vec<_>, _>>();
    let chain = found.ok().filter(|chain| !chain.is_empty());
    chain.ok_or_else(|| not_pem(path, CERTIFICATE))
}

/// What a certificate is presented for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// A learner presents it to its clients.
    Server,
    /// A client presents it to the learner.
    Client,
}

impl Purpose {
    fn usage(self) -> KeyUsage {
        match self {
            Self::Server => KeyUsage::server_auth(),
            Self::Client => KeyUsage::client_auth(),
        }
    }

    /// Name of the purpose in certificates.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Server => "server authentication",
            Self::Client => "client authentication",
        }
    }
}

/// Why a peer would refuse the certificate, read from `path`, that is presented for `purpose` at `now`. The period is
/// checked first, then whether it is an authority, then the purpose. The issuer, which is not known here, is last.
fn objection(
    path: &Path,
    certificate: &CertificateDer<'_>,
    purpose: Purpose,
    now: UnixTime,
) -> Result<webpki::Error, SecurityError> {
    let parsed = EndEntityCert::try_from(certificate).map_err(|why| {
        unusable(path, CERTIFICATE, format!("it is damaged or unsupported ({why})"))
    })?;
    let verified = parsed.verify_for_usage(&[], &[], &[], now, purpose.usage(), None, None);
    Ok(verified.err().unwrap_or(webpki::Error::UnknownIssuer))
}

/// Refuses a certificate, read from `path`, that is not valid at `now`.
fn demand_validity(
    path: &Path,
    certificate: &CertificateDer<'_>,
    now: UnixTime,
) -> Result<(), SecurityError> {
    let objection = objection(path, certificate, Purpose::Client, now)?;
    period(&objection).map_or(Ok(()), |why| Err(refused(path, &why)))
}

/// Refuses a certificate, read from `path`, that all peers would refuse for `purpose` at `now`.
fn demand_usable(
    path: &Path,
    certificate: &CertificateDer<'_>,
    purpose: Purpose,
    now: UnixTime,
) -> Result<(), SecurityError> {
    use webpki::Error::{CaUsedAsEndEntity, EmptyEkuExtension, RequiredEkuNotFoundContext};
    let objection = objection(path, certificate, purpose, now)?;
    let misuse = match &objection {
        // Clients with other rules, such as browsers, accept a server's own authority.
        CaUsedAsEndEntity if purpose == Purpose::Client => {
            Some("is that of an authority; present one that the authority has signed".to_owned())
        }
        RequiredEkuNotFoundContext(_) | EmptyEkuExtension => {
            Some(format!("is not for {} (its extended key usage)", purpose.name()))
        }
        _ => None,
    };
    period(&objection).or(misuse).map_or(Ok(()), |why| Err(refused(path, &why)))
}

fn refused(path: &Path, why: &str) -> SecurityError {
    SecurityError(format!("the certificate {} {why}", path.display()))
}

/// What is wrong with the period of a certificate, if that is the objection.
fn period(objection: &webpki::Error) -> Option<String> {
    match objection {
        webpki::Error::CertExpired { time, not_after } => Some(expired(*not_after, *time)),
        webpki::Error::CertNotValidYet { time, not_before } => {
            Some(not_valid_yet(*not_before, *time))
        }
        _ => None,
    }
}

/// Says of a certificate that it expired before `now`.
pub(crate) fn expired(not_after: UnixTime, now: UnixTime) -> String {
    format!("expired at {} (it is {})", in_utc(not_after), in_utc(now))
}

/// Says of a certificate that it is not valid before `not_before`.
pub(crate) fn not_valid_yet(not_before: UnixTime, now: UnixTime) -> String {
    format!("is valid from {} only (it is {})", in_utc(not_before), in_utc(now))
}

/// A time as `2001-09-09 01:46:40 UTC`.
fn in_utc(time: UnixTime) -> String {
    let secs = i64::try_from(time.as_secs()).ok();
    match secs.and_then(|secs| OffsetDateTime::from_unix_timestamp(secs).ok()) {
        Some(time) => {
            let (hour, minute, second) = time.to_hms();
            format!("{} {hour:02}:{minute:02}:{second:02} UTC", time.date())
        }
        None => format!("{} s after 1970", time.as_secs()),
    }
}

/// The authorities in `pem`, which was read from `path`.
pub(crate) fn authorities(
    path: &Path,
    pem: &[u8],
    now: UnixTime,
) -> Result<RootCertStore, SecurityError> {
    let mut roots = RootCertStore::empty();
    let found = certificates(path, pem)?;
    if !is_of_old_version(&found[0]) {
        demand_validity(path, &found[0], now)?;
    }
    for certificate in found {
        roots.add(certificate).map_err(|error| unusable(path, CERTIFICATE, error.to_string()))?;
    }
    Ok(roots)
}

/// The authorities in `pem`, which was read from `path`, that sign the certificates of clients. The key of any other
/// certificate in it could sign every role: the verification of clients trusts all of them.
pub(crate) fn client_authorities(
    path: &Path,
    pem: &[u8],
    now: UnixTime,
) -> Result<RootCertStore, SecurityError> {
    let roots = authorities(path, pem, now)?;
    for certificate in certificates(path, pem)? {
        if !is_of_old_version(&certificate) && !is_authority(path, &certificate, now)? {
            return Err(SecurityError(format!(
                "{} holds a certificate that is no authority; its key could sign certificates of every role. Name the \
                 file of the authority that signed the certificates of the clients",
                path.display()
            )));
        }
    }
    Ok(roots)
}

/// Whether the certificate, read from `path`, is that of an authority, whatever its period.
fn is_authority(
    path: &Path,
    certificate: &CertificateDer<'_>,
    now: UnixTime,
) -> Result<bool, SecurityError> {
    use webpki::Error::{CaUsedAsEndEntity, CertExpired, CertNotValidYet};
    let at = |time| objection(path, certificate, Purpose::Client, time);
    let objection = match at(now)? {
        CertExpired { not_after: valid, .. } | CertNotValidYet { not_before: valid, .. } => {
            at(valid)?
        }
        other => other,
    };
    Ok(matches!(objection, CaUsedAsEndEntity))
}

/// Whether the certificate is older than X.509 version 3. Rustls accepts such an authority, but cannot read its period.
fn is_of_old_version(certificate: &CertificateDer<'_>) -> bool {
    matches!(EndEntityCert::try_from(certificate), Err(webpki::Error::UnsupportedCertVersion))
}

/// A certificate for `purpose` and its key from the contents of both files.
pub(crate) fn certified_key(
    files: &IdentityFiles,
    certificate_pem: &[u8],
    key_pem: &[u8],
    purpose: Purpose,
    now: UnixTime,
) -> Result<CertifiedKey, SecurityError> {
    let chain = certificates(&files.certificate, certificate_pem)?;
    demand_usable(&files.certificate, &chain[0], purpose, now)?;
    // The parser's message may quote the file, so it is not passed on.
    let key = PrivateKeyDer::from_pem_slice(key_pem).map_err(|_| {
        if is_encrypted(key_pem) { encrypted(&files.key) } else { not_pem(&files.key, PRIVATE_KEY) }
    })?;
    CertifiedKey::from_der(chain, key, &provider()).map_err(|error| match error {
        Error::InconsistentKeys(_) => {
            let (key, certificate) = (files.key.display(), files.certificate.display());
            let why = format!("the private key {key} does not fit the certificate {certificate}");
            SecurityError(why)
        }
        error => unusable(&files.key, PRIVATE_KEY, error.to_string()),
    })
}

/// Whether the contents of a key's file need a passphrase, in the form of RFC 7468, section 11, or of RFC 1421, section 4.6.
fn is_encrypted(pem: &[u8]) -> bool {
    let marks: [&[u8]; 2] = [b"BEGIN ENCRYPTED PRIVATE KEY", b"Proc-Type: 4,ENCRYPTED"];
    marks.iter().any(|mark| pem.windows(mark.len()).any(|part| part == *mark))
}

fn encrypted(path: &Path) -> SecurityError {
    let path = path.display();
    SecurityError(format!("the private key {path} is encrypted; write it without a passphrase"))
}

fn not_pem(path: &Path, expected: &str) -> SecurityError {
    SecurityError(format!("{} holds no {expected} in PEM form", path.display()))
}

pub(crate) fn unusable(path: &Path, what: &str, why: String) -> SecurityError {
    SecurityError(format!("{} holds a {what} that cannot be used: {why}", path.display()))
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::*;
    use crate::development::{Issued, Issuer};
    use crate::role::Role;

    const DAY: Duration = Duration::from_secs(86_400);
    /// 2001-09-09 01:46:40 UTC.
    const ISSUED: Duration = Duration::from_secs(1_000_000_000);

    fn issued() -> Issued {
        let issuer = Issuer::new(SystemTime::UNIX_EPOCH + ISSUED, DAY).unwrap();
        issuer.client(&[Role::Actor]).unwrap()
    }

    fn refusal(certificate: &str, key: &str, at: Duration) -> String {
        refusal_for(Purpose::Client, certificate, key, at)
    }

    fn refusal_for(purpose: Purpose, certificate: &str, key: &str, at: Duration) -> String {
        let files = IdentityFiles { certificate: "own.pem".into(), key: "own.key".into() };
        let now = UnixTime::since_unix_epoch(at);
        let read = certified_key(&files, certificate.as_bytes(), key.as_bytes(), purpose, now);
        read.map_or_else(|error| error.to_string(), |_| "accepted".to_owned())
    }

    #[test]
    fn what_is_wrong_with_a_file_is_one_line_that_never_quotes_a_key() {
        let (own, other) = (issued(), issued());
        let cut = &own.key[..own.key.len() / 2];
        let encrypted = |kind: &str, header: &str| {
            format!(
                "-----BEGIN {kind}PRIVATE KEY-----\n{header}AAAA\n-----END {kind}PRIVATE KEY-----\n"
            )
        };
        let passphrase = "the private key own.key is encrypted; write it without a passphrase";
        let damaged = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
        for (certificate, key, line) in [
            ("", own.key.as_str(), "own.pem holds no certificate in PEM form"),
            (&own.key, &own.key, "own.pem holds no certificate in PEM form"),
            (
                damaged,
                &own.key,
                "own.pem holds a certificate that cannot be used: it is damaged or unsupported (TrailingData(SignedData))",
            ),
            (&own.certificate, "", "own.key holds no private key in PEM form"),
            (&own.certificate, cut, "own.key holds no private key in PEM form"),
            (&own.certificate, &encrypted("ENCRYPTED ", ""), passphrase),
            (&own.certificate, &encrypted("EC ", "Proc-Type: 4,ENCRYPTED\n"), passphrase),
            (
                &own.certificate,
                &other.key,
                "the private key own.key does not fit the certificate own.pem",
            ),
        ] {
            assert_eq!(refusal(certificate, key, ISSUED), line);
        }
    }

    #[test]
    fn a_certificate_is_refused_before_its_first_and_after_its_last_moment() {
        let own = issued();
        let at = |time| refusal(&own.certificate, &own.key, time);
        assert_eq!(at(ISSUED), "accepted");
        assert_eq!(
            at(ISSUED + 2 * DAY),
            "the certificate own.pem expired at 2001-09-10 01:46:40 UTC (it is 2001-09-11 01:46:40 UTC)"
        );
        // Clocks of two machines may differ by five minutes.
        assert_eq!(
            at(ISSUED - DAY),
            "the certificate own.pem is valid from 2001-09-09 01:41:40 UTC only (it is 2001-09-08 01:46:40 UTC)"
        );
    }

    #[test]
    fn a_certificate_of_an_authority_or_for_another_purpose_is_refused_with_that_reason() {
        let issuer = Issuer::new(SystemTime::UNIX_EPOCH + ISSUED, DAY).unwrap();
        let (server, client) = (issuer.server(&["learner".into()]).unwrap(), issued());
        let authority = issuer.certificate();
        let an_authority = "the certificate own.pem is that of an authority; present one that the authority has signed";
        let no_server =
            "the certificate own.pem is not for server authentication (its extended key usage)";
        let no_client =
            "the certificate own.pem is not for client authentication (its extended key usage)";
        let another_key = "the private key own.key does not fit the certificate own.pem";
        for (purpose, certificate, key, line) in [
            (Purpose::Server, &server.certificate, &server.key, "accepted"),
            (Purpose::Server, &client.certificate, &client.key, no_server),
            // Its purpose passes; the key of the authority is not known.
            (Purpose::Server, &authority, &server.key, another_key),
            (Purpose::Client, &client.certificate, &client.key, "accepted"),
            (Purpose::Client, &server.certificate, &server.key, no_client),
            (Purpose::Client, &authority, &client.key, an_authority),
        ] {
            assert_eq!(refusal_for(purpose, certificate, key, ISSUED), line);
        }
    }

    #[test]
    fn an_authority_of_clients_is_one_even_if_it_has_expired() {
        let issuer = |at| Issuer::new(SystemTime::UNIX_EPOCH + at, DAY).unwrap();
        let (now, expired) = (issuer(ISSUED), issuer(ISSUED - 3 * DAY));
        let (leaf, old_leaf) = (now.client(&[]).unwrap(), expired.client(&[]).unwrap());
        let accepts = |second: &str| {
            let pem = [now.certificate().as_str(), second].concat();
            let time = UnixTime::since_unix_epoch(ISSUED);
            let read = client_authorities(Path::new("ca.pem"), pem.as_bytes(), time);
            read.map(|roots| roots.len()).map_err(|error| error.to_string())
        };
        assert_eq!(accepts(""), Ok(1));
        assert_eq!(accepts(&expired.certificate()), Ok(2));
        for certificate in [leaf.certificate, old_leaf.certificate] {
            let line = accepts(&certificate).unwrap_err();
            let expected = "ca.pem holds a certificate that is no authority; ";
            assert!(line.starts_with(expected), "{line}");
        }
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = read(Path::new("no/such.pem")).unwrap_err().to_string();
        assert!(error.starts_with("cannot read no/such.pem: "), "{error}");
        let error = read(Path::new("/dev/zero")).unwrap_err().to_string();
        assert_eq!(error, "cannot read /dev/zero: it has more than 1048576 bytes");
    }
}
