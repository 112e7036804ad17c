//! A failed TLS handshake in words that say what to do.

use std::error::Error;
use std::io;

use rustls::{AlertDescription, CertificateError};

/// What a client should know about the TLS error that `error` is or comes from; `None` if none is behind it.
#[must_use]
pub fn explain(error: &(dyn Error + 'static)) -> Option<String> {
    tls_error(error).map(words).or_else(|| explain(error.source()?))
}

fn tls_error<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a rustls::Error> {
    // An `io::Error` is no source of itself: what it wraps has to be asked for.
    let inner = error.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
    error.downcast_ref().or_else(|| inner.and_then(|inner| inner.downcast_ref()))
}

fn words(error: &rustls::Error) -> String {
    use rustls::Error::{AlertReceived, InvalidCertificate, InvalidMessage};
    match error {
        InvalidMessage(_) => "the learner speaks no TLS there; use an http:// URL".to_owned(),
        InvalidCertificate(why) => format!("the learner's certificate is refused: {}", reason(why)),
        AlertReceived(alert) => format!("the learner refuses this certificate: {}", told(*alert)),
        other => format!("no TLS connection: {other}"),
    }
}

fn reason(why: &CertificateError) -> String {
    match why {
        CertificateError::UnknownIssuer | CertificateError::BadSignature => {
            "the authority given with --tls-ca has not signed it".to_owned()
        }
        other => other.to_string(),
    }
}

fn told(alert: AlertDescription) -> String {
    match alert {
        AlertDescription::CertificateRequired => "it wants one and got none".to_owned(),
        AlertDescription::UnknownCA | AlertDescription::DecryptError => {
            "another authority has signed it".to_owned()
        }
        AlertDescription::CertificateExpired => "it has expired".to_owned(),
        other => format!("{other:?}"),
    }
}
