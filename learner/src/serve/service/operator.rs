//! The client of `ControlService`: one connection, with a timeout for each response.

use std::time::Duration;

use proto::wire::control_service_client::ControlServiceClient;
use proto::{Authorization, RunLine, Status, wire};
use security::{ClientTls, Token};
use tonic::Streaming;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;

use crate::serve::client::{CallError, answered, call_failed, connect};

/// A connection to the control service of a learner.
#[derive(Clone, Debug)]
pub struct Operator {
    url: String,
    timeout: Duration,
    service: ControlServiceClient<InterceptedService<Channel, Authorization>>,
}

/// A stream of the run's lines.
#[derive(Debug)]
pub struct WatchedLines {
    url: String,
    stream: Streaming<wire::WatchRunResponse>,
}

impl Operator {
    /// Connects to the learner at `url`, over TLS with `tls`; each call carries `token`. Each response may take `timeout`.
    ///
    /// # Errors
    /// The URL is invalid, or the learner does not respond.
    pub async fn connect(
        url: &str,
        tls: Option<&ClientTls>,
        token: Option<&Token>,
        timeout: Duration,
    ) -> Result<Self, CallError> {
        let channel = connect(url, tls, timeout).await?;
        let header = token.map(Token::header);
        let authorization = Authorization::new(header.as_deref());
        let service = ControlServiceClient::with_interceptor(channel, authorization);
        Ok(Self { url: url.to_owned(), timeout, service })
    }

    /// The status of the run.
    ///
    /// # Errors
    /// No response, or the call is rejected.
    pub async fn status(&mut self) -> Result<Status, CallError> {
        let answer = self.service.get_status(wire::GetStatusRequest {});
        Ok(Status::from_wire(answered(&self.url, self.timeout, answer).await?))
    }

    /// Stops the learner after a checkpoint.
    ///
    /// # Errors
    /// No response, or the call is rejected.
    pub async fn stop(&mut self) -> Result<(), CallError> {
        let answer = self.service.stop(wire::StopRequest {});
        answered(&self.url, self.timeout, answer).await.map(drop)
    }

    /// Streams the lines of iterations after `after_iteration`.
    ///
    /// # Errors
    /// No response, or the call is rejected.
    pub async fn watch(&mut self, after_iteration: u64) -> Result<WatchedLines, CallError> {
        let answer = self.service.watch_run(wire::WatchRunRequest { after_iteration });
        let stream = answered(&self.url, self.timeout, answer).await?;
        Ok(WatchedLines { url: self.url.clone(), stream })
    }
}

impl WatchedLines {
    /// The next line; `None` after the last. There is no timeout besides the keepalive, since iterations may take long.
    ///
    /// # Errors
    /// The connection broke, or the line is invalid.
    pub async fn next(&mut self) -> Result<Option<RunLine>, CallError> {
        let line = self.stream.message().await.map_err(|status| call_failed(&self.url, &status))?;
        line.map(RunLine::from_wire)
            .transpose()
            .map_err(|wrong| call_failed(&self.url, &wrong.into()))
    }
}
