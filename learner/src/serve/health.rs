//! Asking a learner whether it serves, by the standard gRPC health protocol.

use std::time::Duration;

use security::{ClientFiles, SecurityError};
use tonic::Code;
use tonic::transport::{Certificate, ClientTlsConfig, Endpoint, Identity};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

/// Why a learner does not count as healthy, or does not do what it was asked for.
#[derive(Debug, thiserror::Error)]
pub enum HealthError {
    /// The address is no URL.
    #[error("`{url}` is no URL such as http://HOST:50051: {detail}")]
    Address {
        /// What was given.
        url: String,
        /// What is wrong with it.
        detail: String,
    },
    /// A certificate or a key cannot be used.
    #[error(transparent)]
    Credentials(#[from] SecurityError),
    /// Nobody answered there.
    #[error("{url} does not answer: {detail}")]
    Silent {
        /// Who was asked.
        url: String,
        /// What went wrong.
        detail: String,
    },
    /// Somebody answered, but not what was asked for.
    #[error("{url} refuses: {detail}")]
    Refused {
        /// Who was asked.
        url: String,
        /// The reason given.
        detail: String,
    },
    /// Somebody answered, but not that it serves.
    #[error("{url} answers {status}")]
    NotServing {
        /// Who was asked.
        url: String,
        /// The status, as the protocol names it.
        status: &'static str,
    },
}

/// Asks the learner at `url` once, over TLS with `tls`, and waits at most `patience`.
///
/// # Errors
/// Says why it does not count as healthy.
pub async fn demand_serving(
    url: &str,
    tls: Option<&ClientFiles>,
    patience: Duration,
) -> Result<(), HealthError> {
    let asked = ask(url, endpoint(url, tls)?);
    let status =
        tokio::time::timeout(patience, asked).await.map_err(|_| silent(url, patience))??;
    match status {
        ServingStatus::Serving => Ok(()),
        other => Err(HealthError::NotServing { url: url.to_owned(), status: other.as_str_name() }),
    }
}

/// Where a question goes, and what is shown there.
pub(crate) fn endpoint(url: &str, tls: Option<&ClientFiles>) -> Result<Endpoint, HealthError> {
    let wrong = |error: tonic::transport::Error| HealthError::Address {
        url: url.to_owned(),
        detail: innermost(&error),
    };
    let endpoint = Endpoint::from_shared(url.to_owned()).map_err(wrong)?;
    let Some(files) = tls else { return Ok(endpoint) };
    let own = files.read()?;
    let config = ClientTlsConfig::new()
        .ca_certificate(Certificate::from_pem(own.authority))
        .identity(Identity::from_pem(own.certificate, own.key));
    let config = match &files.server_name {
        Some(name) => config.domain_name(name),
        None => config,
    };
    endpoint.tls_config(config).map_err(wrong)
}

async fn ask(url: &str, endpoint: Endpoint) -> Result<ServingStatus, HealthError> {
    let channel = endpoint.connect().await.map_err(|error| no_connection(url, &error))?;
    // The empty name asks for the server as a whole.
    let request = HealthCheckRequest { service: String::new() };
    let answer = HealthClient::new(channel).check(request).await;
    Ok(answer.map_err(|status| why_not(url, &status))?.into_inner().status())
}

/// Nothing came in time.
pub(crate) fn silent(url: &str, patience: Duration) -> HealthError {
    let detail = format!("nothing came for {} s", patience.as_secs_f64());
    HealthError::Silent { url: url.to_owned(), detail }
}

/// Why no connection came about.
pub(crate) fn no_connection(url: &str, error: &(dyn std::error::Error + 'static)) -> HealthError {
    let detail = security::explain(error).unwrap_or_else(|| innermost(error));
    HealthError::Silent { url: url.to_owned(), detail }
}

/// Whether the learner at `url` itself said no to a call, or was lost on the way.
pub(crate) fn why_not(url: &str, status: &tonic::Status) -> HealthError {
    let (url, detail) = (url.to_owned(), denial(status));
    match status.code() {
        Code::InvalidArgument
        | Code::FailedPrecondition
        | Code::PermissionDenied
        | Code::Unimplemented => HealthError::Refused { url, detail },
        _ => HealthError::Silent { url, detail },
    }
}

/// Why a call failed: the learner's own words, or what is behind a connection that broke.
fn denial(status: &tonic::Status) -> String {
    const TLS: &str = "give --tls-ca, --tls-certificate and --tls-key, and https:// in a URL";
    let broken = status.message().starts_with("h2 protocol error");
    let told = || match status.code() {
        // How HTTP/2 names a goodbye for inadequate security; it may be lost on the way.
        Code::PermissionDenied if broken => format!("it asks for TLS: {TLS}"),
        Code::Cancelled => format!("it ended the connection at once; if it asks for TLS, {TLS}"),
        _ if broken => "what listens there speaks no gRPC".to_owned(),
        _ => proto::in_words(status),
    };
    security::explain(status).unwrap_or_else(told)
}

/// The last cause says what happened; those before it only that something did.
fn innermost(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(next) = cause.source() {
        cause = next;
    }
    cause.to_string()
}
