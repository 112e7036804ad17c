//! A learner as people and scripts call it: one connection, each answer awaited for so long and no longer.

use std::time::Duration;

use proto::wire::control_service_client::ControlServiceClient;
use proto::{RunLine, Status, wire};
use security::ClientFiles;
use tonic::transport::Channel;
use tonic::{Response, Streaming};

use crate::health::{self, HealthError, no_connection, silent, why_not};

/// A learner of which nothing came is asked for a sign of life after this long, so that nobody watches one that is
/// out of reach for ever.
const KEEPALIVE: Duration = Duration::from_secs(30);

/// A connection to the control service of a learner.
#[derive(Clone, Debug)]
pub struct Operator {
    url: String,
    patience: Duration,
    service: ControlServiceClient<Channel>,
}

/// A checkpoint on the learner's machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DistantCheckpoint {
    /// Finished iterations in it.
    pub iteration: u64,
    /// Its directory.
    pub path: String,
}

/// The lines of a run as they come.
#[derive(Debug)]
pub struct WatchedLines {
    url: String,
    stream: Streaming<wire::WatchRunResponse>,
}

impl Operator {
    /// Connects to the learner at `url`, over TLS with `tls`. Each answer may take `patience`.
    ///
    /// # Errors
    /// The address is no URL, a certificate cannot be used, or nobody answers there.
    pub async fn connect(
        url: &str,
        tls: Option<&ClientFiles>,
        patience: Duration,
    ) -> Result<Self, HealthError> {
        let endpoint = health::endpoint(url, tls)?
            .http2_keep_alive_interval(KEEPALIVE)
            .keep_alive_timeout(super::KEEPALIVE_TIMEOUT)
            .keep_alive_while_idle(true);
        let connected = tokio::time::timeout(patience, endpoint.connect()).await;
        let channel = connected
            .map_err(|_| silent(url, patience))?
            .map_err(|error| no_connection(url, &error))?;
        Ok(Self { url: url.to_owned(), patience, service: ControlServiceClient::new(channel) })
    }

    /// Where the run stands.
    ///
    /// # Errors
    /// No answer, or a refusal.
    pub async fn status(&mut self) -> Result<Status, HealthError> {
        let answer = self.service.get_status(wire::GetStatusRequest {});
        Ok(Status::from_wire(answered(&self.url, self.patience, answer).await?))
    }

    /// Pauses the run; how many leases go on to their end.
    ///
    /// # Errors
    /// No answer, or a refusal.
    pub async fn pause(&mut self) -> Result<u64, HealthError> {
        let answer = self.service.pause(wire::PauseRequest {});
        Ok(answered(&self.url, self.patience, answer).await?.open_leases)
    }

    /// Lets a paused run go on.
    ///
    /// # Errors
    /// No answer, or a refusal.
    pub async fn resume(&mut self) -> Result<(), HealthError> {
        let answer = self.service.resume(wire::ResumeRequest {});
        answered(&self.url, self.patience, answer).await.map(drop)
    }

    /// Waits for a checkpoint of the last finished iteration.
    ///
    /// # Errors
    /// No answer, a refusal, or it could not be written.
    pub async fn save_checkpoint(&mut self) -> Result<DistantCheckpoint, HealthError> {
        let answer = self.service.save_checkpoint(wire::SaveCheckpointRequest {});
        let wire::SaveCheckpointResponse { iteration, path } =
            answered(&self.url, self.patience, answer).await?;
        Ok(DistantCheckpoint { iteration, path })
    }

    /// Ends the learner after a checkpoint.
    ///
    /// # Errors
    /// No answer, or a refusal.
    pub async fn stop(&mut self) -> Result<(), HealthError> {
        let answer = self.service.stop(wire::StopRequest {});
        answered(&self.url, self.patience, answer).await.map(drop)
    }

    /// The lines of iterations after this one, as they come.
    ///
    /// # Errors
    /// No answer, or a refusal.
    pub async fn watch(&mut self, after_iteration: u64) -> Result<WatchedLines, HealthError> {
        let answer = self.service.watch_run(wire::WatchRunRequest { after_iteration });
        let stream = answered(&self.url, self.patience, answer).await?;
        Ok(WatchedLines { url: self.url.clone(), stream })
    }
}

impl WatchedLines {
    /// The next line; `None` if the learner has no more. Iterations may take long, so nothing limits the wait but the
    /// connection.
    ///
    /// # Errors
    /// The connection broke, or what came is no line.
    pub async fn next(&mut self) -> Result<Option<RunLine>, HealthError> {
        let line = self.stream.message().await.map_err(|status| why_not(&self.url, &status))?;
        line.map(RunLine::from_wire).transpose().map_err(|wrong| why_not(&self.url, &wrong.into()))
    }
}

async fn answered<T>(
    url: &str,
    patience: Duration,
    answer: impl Future<Output = Result<Response<T>, tonic::Status>>,
) -> Result<T, HealthError> {
    let answer = tokio::time::timeout(patience, answer).await;
    let answer = answer.map_err(|_| silent(url, patience))?;
    answer.map(Response::into_inner).map_err(|status| why_not(url, &status))
}
