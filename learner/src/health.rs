//! Asking a learner whether it serves, by the standard gRPC health protocol.

use std::time::Duration;

use tonic::transport::Endpoint;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

/// Why a learner does not count as healthy.
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
    /// Nobody answered there.
    #[error("{url} does not answer: {detail}")]
    Silent {
        /// Who was asked.
        url: String,
        /// What went wrong.
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

/// Asks the learner at `url` once and waits at most `patience`.
///
/// # Errors
/// Says why it does not count as healthy.
pub async fn demand_serving(url: &str, patience: Duration) -> Result<(), HealthError> {
    let endpoint = Endpoint::from_shared(url.to_owned())
        .map_err(|error| HealthError::Address { url: url.to_owned(), detail: error.to_string() })?;
    let silent = |detail: String| HealthError::Silent { url: url.to_owned(), detail };
    let answer = tokio::time::timeout(patience, ask(endpoint)).await;
    let status = answer
        .map_err(|_| silent(format!("nothing came for {} s", patience.as_secs_f64())))?
        .map_err(silent)?;
    match status {
        ServingStatus::Serving => Ok(()),
        other => Err(HealthError::NotServing { url: url.to_owned(), status: other.as_str_name() }),
    }
}

async fn ask(endpoint: Endpoint) -> Result<ServingStatus, String> {
    let channel = endpoint.connect().await.map_err(|error| innermost(&error))?;
    // The empty name asks for the server as a whole.
    let request = HealthCheckRequest { service: String::new() };
    let answer = HealthClient::new(channel).check(request).await;
    answer.map(|found| found.into_inner().status()).map_err(|status| status.to_string())
}

/// The last cause says what happened; those before it only that something did.
pub(crate) fn innermost(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(next) = cause.source() {
        cause = next;
    }
    cause.to_string()
}
