//! The client of `ControlService`: one connection, with a timeout for each response.

use std::time::Duration;

use proto::wire::control_service_client::ControlServiceClient;
use proto::{Authorization, RunLine, Status, wire};
use security::{ClientTls, Token};
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Response, Streaming};

use crate::health::{self, HealthError, call_failed, connect_failed, timed_out};
use crate::token::authorization;

/// Interval of keepalive pings, so that a watcher notices an unreachable learner.
const KEEPALIVE: Duration = Duration::from_secs(30);

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
    ) -> Result<Self, HealthError> {
        let endpoint = health::endpoint(url, tls)?
            .http2_keep_alive_interval(KEEPALIVE)
            .keep_alive_timeout(super::KEEPALIVE_TIMEOUT)
            .keep_alive_while_idle(true);
        let connected = tokio::time::timeout(timeout, endpoint.connect()).await;
        let channel = connected
            .map_err(|_| timed_out(url, timeout))?
            .map_err(|error| connect_failed(url, &error))?;
        let service = ControlServiceClient::with_interceptor(channel, authorization(token));
        Ok(Self { url: url.to_owned(), timeout, service })
    }

    /// The status of the run.
    ///
    /// # Errors
    /// No response, or the call is rejected.
    pub async fn status(&mut self) -> Result<Status, HealthError> {
        let answer = self.service.get_status(wire::GetStatusRequest {});
        Ok(Status::from_wire(answered(&self.url, self.timeout, answer).await?))
    }

    /// Stops the learner after a checkpoint.
    ///
    /// # Errors
    /// No response, or the call is rejected.
    pub async fn stop(&mut self) -> Result<(), HealthError> {
        let answer = self.service.stop(wire::StopRequest {});
        answered(&self.url, self.timeout, answer).await.map(drop)
    }

    /// Streams the lines of iterations after `after_iteration`.
    ///
    /// # Errors
    /// No response, or the call is rejected.
    pub async fn watch(&mut self, after_iteration: u64) -> Result<WatchedLines, HealthError> {
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
    pub async fn next(&mut self) -> Result<Option<RunLine>, HealthError> {
        let line = self.stream.message().await.map_err(|status| call_failed(&self.url, &status))?;
        line.map(RunLine::from_wire)
            .transpose()
            .map_err(|wrong| call_failed(&self.url, &wrong.into()))
    }
}

async fn answered<T>(
    url: &str,
    timeout: Duration,
    answer: impl Future<Output = Result<Response<T>, tonic::Status>>,
) -> Result<T, HealthError> {
    let answer = tokio::time::timeout(timeout, answer).await;
    let answer = answer.map_err(|_| timed_out(url, timeout))?;
    answer.map(Response::into_inner).map_err(|status| call_failed(url, &status))
}
