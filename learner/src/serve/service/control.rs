//! `ControlService`: status, watching and operator commands, each with the role it requires.

use std::sync::Arc;

use proto::wire;
use proto::wire::control_service_server::ControlService;
use security::Role;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use crate::lease::exchange::Exchange;
use crate::serve::service::connections::{caller, demand, demand_token};

/// Lines buffered per watcher; the exchange keeps the others.
const LINES_AHEAD: usize = 16;

/// The calls of `ControlService`.
#[derive(Debug)]
pub(super) struct Control {
    pub(super) exchange: Arc<Exchange>,
}

#[tonic::async_trait]
impl ControlService for Control {
    async fn get_status(
        &self,
        request: Request<wire::GetStatusRequest>,
    ) -> Result<Response<wire::GetStatusResponse>, Status> {
        demand(&request, Role::Operator)?;
        Ok(Response::new(self.exchange.status().to_wire()))
    }

    type WatchRunStream = ReceiverStream<Result<wire::WatchRunResponse, Status>>;

    async fn watch_run(
        &self,
        request: Request<wire::WatchRunRequest>,
    ) -> Result<Response<Self::WatchRunStream>, Status> {
        demand(&request, Role::Operator)?;
        // A full channel means a slow watcher; it misses lines that the exchange no longer keeps.
        let (sender, stream) = mpsc::channel(LINES_AHEAD);
        let caller = caller(&request, "watch_run");
        let after = request.into_inner().after_iteration;
        tracing::info!("{caller}: lines after iteration {after}");
        tokio::spawn(show_lines(Arc::clone(&self.exchange), after, sender));
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn stop(
        &self,
        request: Request<wire::StopRequest>,
    ) -> Result<Response<wire::StopResponse>, Status> {
        demand(&request, Role::Operator)?;
        demand_token(&request)?;
        self.exchange.request_stop();
        tracing::info!("{}: the run stops after a checkpoint", caller(&request, "stop"));
        Ok(Response::new(wire::StopResponse {}))
    }
}

/// Sends each line after iteration `seen` once, until the run's last line or until the watcher disconnects.
async fn show_lines(
    exchange: Arc<Exchange>,
    mut seen: u64,
    watcher: mpsc::Sender<Result<wire::WatchRunResponse, Status>>,
) {
    let mut lines = exchange.lines();
    loop {
        let news = lines.borrow_and_update().after(seen);
        for line in news {
            seen = line.iteration;
            if watcher.send(Ok(line.to_wire())).await.is_err() || line.end.is_some() {
                return;
            }
        }
        let changed = tokio::select! {
            () = watcher.closed() => return,
            changed = lines.changed() => changed,
        };
        if changed.is_err() {
            return;
        }
    }
}
