//! Client of a learner: connections, timeouts, the health check, and errors of calls.

use std::error::Error as _;
use std::time::Duration;

use security::ClientTls;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Code, Response, Status};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

/// Interval of keepalive pings, so that a watcher notices an unreachable learner.
const KEEPALIVE: Duration = Duration::from_secs(30);
/// Time after which a connection is closed that does not answer a ping.
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(10);

/// Why a call to a learner failed, or its health check.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The learner cannot be reached, or the connection broke.
    #[error("{url} does not answer: {detail}")]
    Unreachable {
        /// URL of the learner.
        url: String,
        /// The reason.
        detail: String,
    },
    /// The learner did not respond in time.
    #[error("{url} does not answer: no response within {} s", .timeout.as_secs_f64())]
    TimedOut {
        /// URL of the learner.
        url: String,
        /// The timeout.
        timeout: Duration,
    },
    /// The URL is invalid.
    #[error("`{url}` is not a URL such as http://HOST:50051: {detail}")]
    InvalidUrl {
        /// The URL.
        url: String,
        /// The reason.
        detail: String,
    },
    /// The TLS settings of the two sides do not match, or the learner rejected the call or reports another status than
    /// `SERVING`. A retry fails, too.
    #[error("{0}")]
    Final(String),
}

impl CallError {
    /// There is no connection to `url`, because the TLS settings of the two sides do not match.
    #[must_use]
    pub fn no_session(url: &str, why: &str) -> Self {
        Self::Final(format!("no session with {url}: {why}"))
    }
}

/// Checks once that the learner at `url` reports `SERVING`, within `timeout`, over TLS with `tls`.
///
/// # Errors
/// The learner is not healthy or does not respond.
pub async fn demand_serving(
    url: &str,
    tls: Option<&ClientTls>,
    timeout: Duration,
) -> Result<(), CallError> {
    // The empty name means the whole server.
    let request = HealthCheckRequest { service: String::new() };
    let check = async {
        let channel = connect(url, tls, timeout).await?;
        answered(url, timeout, HealthClient::new(channel).check(request)).await
    };
    let answer = tokio::time::timeout(timeout, check).await;
    let answer = answer.map_err(|_| timed_out(url, timeout))??;
    match answer.status() {
        ServingStatus::Serving => Ok(()),
        other => Err(CallError::Final(format!("{url} reports {}", other.as_str_name()))),
    }
}

/// The endpoint at `url`, with the client certificate of `tls`.
fn endpoint(url: &str, tls: Option<&ClientTls>) -> Result<Endpoint, CallError> {
    let wrong = |detail: String| CallError::InvalidUrl { url: url.to_owned(), detail };
    let invalid = |error: tonic::transport::Error| wrong(innermost(&error));
    security::addresses::check_port(url).map_err(|port| wrong(port.to_string()))?;
    let endpoint = Endpoint::from_shared(url.to_owned()).map_err(invalid)?;
    if !matches!(endpoint.uri().scheme_str(), Some("http" | "https")) {
        return Err(wrong("it begins with neither http:// nor https://".to_owned()));
    }
    let Some(tls) = tls else { return Ok(endpoint) };
    let mut config = ClientTlsConfig::new()
        .ca_certificate(Certificate::from_pem(&tls.authority))
        .identity(Identity::from_pem(&tls.certificate, &tls.key));
    if let Some(name) = &tls.server_name {
        config = config.domain_name(name);
    }
    endpoint.tls_config(config).map_err(invalid)
}

/// Connects to the server at `url` within `timeout`, over TLS with `tls`.
pub(crate) async fn connect(
    url: &str,
    tls: Option<&ClientTls>,
    timeout: Duration,
) -> Result<Channel, CallError> {
    let endpoint = endpoint(url, tls)?
        .http2_keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE_TIMEOUT)
        .keep_alive_while_idle(true);
    match tokio::time::timeout(timeout, endpoint.connect()).await {
        Ok(connected) => connected.map_err(|error| match security::explain(&error) {
            Some(why) => CallError::no_session(url, &why),
            None => CallError::Unreachable { url: url.to_owned(), detail: innermost(&error) },
        }),
        Err(_) => Err(timed_out(url, timeout)),
    }
}

/// The answer to a call, which may take `timeout`.
pub(crate) async fn answered<T>(
    url: &str,
    timeout: Duration,
    answer: impl Future<Output = Result<Response<T>, Status>>,
) -> Result<T, CallError> {
    match tokio::time::timeout(timeout, answer).await {
        Ok(answer) => answer.map(Response::into_inner).map_err(|status| call_failed(url, &status)),
        Err(_) => Err(timed_out(url, timeout)),
    }
}

fn timed_out(url: &str, timeout: Duration) -> CallError {
    CallError::TimedOut { url: url.to_owned(), timeout }
}

/// The error for a failed call: rejected by the learner at `url`, refused by TLS, or lost in transit.
pub(crate) fn call_failed(url: &str, status: &Status) -> CallError {
    if let Some(why) = security::explain(status) {
        return CallError::no_session(url, &why);
    }
    let detail = explanation(url, status);
    match status.code() {
        Code::InvalidArgument
        | Code::FailedPrecondition
        | Code::PermissionDenied
        | Code::Unauthenticated
        | Code::Unimplemented => CallError::Final(format!("{url} rejected the call: {detail}")),
        _ => CallError::Unreachable { url: url.to_owned(), detail },
    }
}

/// Why a call failed: the learner's message, or the cause of a broken connection.
fn explanation(url: &str, status: &Status) -> String {
    const REFUSED: &str = "it closed the connection: it may have ended, not accept this client certificate (its authority must be that \
                           of --tls-client-ca), or not speak gRPC";
    const BROKEN: &str = "it closed the connection or does not speak gRPC; if it requires TLS, pass --tls-ca, \
                          --tls-certificate and --tls-key, and use https:// in the URL";
    /// What tonic says of an HTTP answer that is none of gRPC.
    const NOT_GRPC: &str = "grpc-status header missing";
    let said = status.message();
    // An answer of the server has no source.
    let is_lost = status.source().is_some() || said.is_empty() || said.starts_with(NOT_GRPC);
    let is_vague = matches!(status.code(), Code::Cancelled | Code::Unknown);
    if said.starts_with("h2 protocol error") || is_vague && is_lost {
        return if url.starts_with("https://") { REFUSED } else { BROKEN }.to_owned();
    }
    proto::in_words(status)
}

/// The innermost cause, which is the most specific.
fn innermost(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(next) = cause.source() {
        cause = next;
    }
    cause.to_string()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio_rustls::rustls::{AlertDescription, Error};

    use super::*;

    #[test]
    fn a_refused_certificate_is_final_and_a_broken_connection_is_not() {
        let failed = |alert: AlertDescription| {
            let mut status = Status::unavailable("");
            status.set_source(Arc::new(Error::AlertReceived(alert)));
            call_failed("https://learner:1", &status)
        };
        let refused = failed(AlertDescription::UnknownCA);
        assert_eq!(
            refused.to_string(),
            "no session with https://learner:1: the learner refuses this certificate: another authority has signed it"
        );
        assert!(matches!(refused, CallError::Final(_)));
        let broken = failed(AlertDescription::BadRecordMac);
        assert!(matches!(broken, CallError::Unreachable { .. }), "{broken}");
    }
}
