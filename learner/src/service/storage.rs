//! What the health service says of the disk. The learner as a whole keeps serving: training goes on.

use tokio::sync::watch;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use crate::exchange::Storage;

/// The name under which the health service answers for checkpoints: `NOT_SERVING` while they fail.
pub const STORAGE: &str = "s2mia.v1.Storage";

/// Reports every change until the exchange is gone.
pub(super) async fn follow(mut storage: watch::Receiver<Storage>, reporter: HealthReporter) {
    loop {
        let status = match *storage.borrow_and_update() {
            Storage::Sound => ServingStatus::Serving,
            Storage::Degraded => ServingStatus::NotServing,
        };
        reporter.set_service_status(STORAGE, status).await;
        if storage.changed().await.is_err() {
            return;
        }
    }
}
