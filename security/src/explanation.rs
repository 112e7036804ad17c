//! Explanations of failed TLS handshakes.

use std::error::Error;
use std::io;

use rustls::{AlertDescription, CertificateError, InvalidMessage, OtherError};

use crate::files::{Purpose, expired, not_valid_yet};

/// Explanation, for the user of a client, of the TLS error that `error` is or comes from. `None` if there is no TLS
/// error, and for transient ones, such as corrupted data, after which a retry may succeed.
#[must_use]
pub fn explain(error: &(dyn Error + 'static)) -> Option<String> {
    tls_error(error).and_then(words).or_else(|| explain(error.source()?))
}

/// Explanation, for the log of a learner, of a failed handshake with a client.
#[must_use]
pub fn explain_rejection(error: &io::Error) -> String {
    match tls_error(error) {
        Some(rustls::Error::InvalidMessage(InvalidMessage::InvalidContentType)) => {
            "the peer speaks plain text, but this learner requires TLS".to_owned()
        }
        _ => error.to_string(),
    }
}

fn tls_error<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a rustls::Error> {
    // The source of an `io::Error` is not the error that it wraps.
    let inner = error.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
    error.downcast_ref().or_else(|| inner.and_then(|inner| inner.downcast_ref()))
}

fn words(error: &rustls::Error) -> Option<String> {
    use rustls::Error::{AlertReceived, InvalidCertificate, InvalidMessage};
    match error {
        InvalidMessage(_) => Some("the learner does not use TLS; use an http:// URL".to_owned()),
        InvalidCertificate(why) => {
            Some(format!("the learner's certificate is refused: {}", reason(why)))
        }
        AlertReceived(alert) => {
            refusal(*alert).map(|why| format!("the learner refuses this certificate: {why}"))
        }
        _ => None,
    }
}

fn reason(why: &CertificateError) -> String {
    match why {
        CertificateError::UnknownIssuer | CertificateError::BadSignature => {
            "the authority given with --tls-ca has not signed it".to_owned()
        }
        CertificateError::ExpiredContext { time, not_after } => {
            format!("it {}", expired(*not_after, *time))
        }
        CertificateError::NotValidYetContext { time, not_before } => {
            format!("it {}", not_valid_yet(*not_before, *time))
        }
        CertificateError::InvalidPurposeContext { .. } => {
            format!("it is not for {} (its extended key usage)", Purpose::Server.name())
        }
        CertificateError::Other(OtherError(why)) if is_of_authority(why.as_ref()) => {
            "it is that of an authority; the learner must present one that the authority has signed"
                .to_owned()
        }
        other => other.to_string(),
    }
}

fn is_of_authority(why: &(dyn Error + Send + Sync + 'static)) -> bool {
    matches!(why.downcast_ref::<webpki::Error>(), Some(webpki::Error::CaUsedAsEndEntity))
}

fn refusal(alert: AlertDescription) -> Option<&'static str> {
    match alert {
        AlertDescription::CertificateRequired => Some("it requires one and received none"),
        AlertDescription::UnknownCA | AlertDescription::DecryptError => {
            Some("another authority has signed it")
        }
        AlertDescription::CertificateExpired => Some("it has expired"),
        AlertDescription::BadCertificate
        | AlertDescription::UnsupportedCertificate
        | AlertDescription::CertificateRevoked
        | AlertDescription::CertificateUnknown => Some("its log says why"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::Duration;

    use rustls::ExtendedKeyPurpose;
    use rustls::pki_types::UnixTime;

    use super::*;

    fn explained(error: rustls::Error) -> Option<String> {
        explain(&io::Error::new(io::ErrorKind::InvalidData, error))
    }

    #[test]
    fn a_certificate_that_is_refused_is_told_from_a_connection_that_broke() {
        use rustls::Error::AlertReceived;
        let line = explained(AlertReceived(AlertDescription::CertificateExpired));
        let expired = "the learner refuses this certificate: it has expired";
        assert_eq!(line.as_deref(), Some(expired));
        assert_eq!(explained(AlertReceived(AlertDescription::BadRecordMac)), None);
        assert_eq!(explained(rustls::Error::DecryptError), None);
        assert_eq!(explain(&io::Error::from(io::ErrorKind::ConnectionReset)), None);
    }

    #[test]
    fn a_certificate_that_the_learner_must_not_present_is_refused_with_the_reason() {
        let at = |day: u64| UnixTime::since_unix_epoch(Duration::from_secs(day * 86_400));
        let expired = CertificateError::ExpiredContext { time: at(2), not_after: at(1) };
        let early = CertificateError::NotValidYetContext { time: at(1), not_before: at(2) };
        let (required, presented) = (ExtendedKeyPurpose::ServerAuth, Vec::new());
        let purpose = CertificateError::InvalidPurposeContext { required, presented };
        let authority = OtherError(Arc::new(webpki::Error::CaUsedAsEndEntity));
        for (error, words) in [
            (expired, "it expired at 1970-01-02 00:00:00 UTC (it is 1970-01-03 00:00:00 UTC)"),
            (
                early,
                "it is valid from 1970-01-03 00:00:00 UTC only (it is 1970-01-02 00:00:00 UTC)",
            ),
            (purpose, "it is not for server authentication (its extended key usage)"),
            (
                CertificateError::Other(authority),
                "it is that of an authority; the learner must present one that the authority has signed",
            ),
        ] {
            let line = explained(rustls::Error::InvalidCertificate(error)).unwrap();
            assert_eq!(line, format!("the learner's certificate is refused: {words}"));
        }
    }

    #[test]
    fn only_a_first_byte_of_another_protocol_is_plain_text() {
        let explained = |why: InvalidMessage| {
            let error = rustls::Error::InvalidMessage(why);
            explain_rejection(&io::Error::new(io::ErrorKind::InvalidData, error))
        };
        let plain = "the peer speaks plain text, but this learner requires TLS";
        assert_eq!(explained(InvalidMessage::InvalidContentType), plain);
        assert!(explained(InvalidMessage::MessageTooLarge).contains("MessageTooLarge"));
    }
}
