//! `ControlService`: the answer of a learner at work, and the question.

use std::sync::Arc;
use std::time::Duration;

use proto::wire::control_service_client::ControlServiceClient;
use proto::wire::control_service_server::ControlService;
use proto::{Status, wire};
use security::ClientFiles;
use tonic::transport::Endpoint;
use tonic::{Request, Response};

use crate::exchange::Exchange;
use crate::health::{self, HealthError, denial, reason};

/// The calls of `ControlService`.
#[derive(Debug)]
pub(super) struct Control {
    pub(super) exchange: Arc<Exchange>,
}

#[tonic::async_trait]
impl ControlService for Control {
    async fn get_status(
        &self,
        _request: Request<wire::GetStatusRequest>,
    ) -> Result<Response<wire::GetStatusResponse>, tonic::Status> {
        Ok(Response::new(self.exchange.status().to_wire()))
    }
}

/// Asks the learner at `url` once where its run stands, over TLS with `tls`, and waits at most `patience`.
///
/// # Errors
/// The address is no URL, a certificate cannot be used, or nobody answers there.
pub async fn status(
    url: &str,
    tls: Option<&ClientFiles>,
    patience: Duration,
) -> Result<Status, HealthError> {
    let endpoint = health::endpoint(url, tls)?;
    let silent = |detail: String| HealthError::Silent { url: url.to_owned(), detail };
    let answer = tokio::time::timeout(patience, ask(endpoint)).await;
    answer
        .map_err(|_| silent(format!("nothing came for {} s", patience.as_secs_f64())))?
        .map_err(silent)
}

async fn ask(endpoint: Endpoint) -> Result<Status, String> {
    let channel = endpoint.connect().await.map_err(|error| reason(&error))?;
    let answer = ControlServiceClient::new(channel).get_status(wire::GetStatusRequest {}).await;
    answer.map(|found| Status::from_wire(found.into_inner())).map_err(|status| denial(&status))
}
