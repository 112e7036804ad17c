//! Reports the state of the disk in the health service. The learner itself stays `SERVING`, since training continues.

use tokio::sync::watch;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use crate::lease::exchange::Storage;

/// Name of the health service's entry for checkpoints; `NOT_SERVING` while they fail.
pub(crate) const STORAGE: &str = "s2mia.v1.Storage";

/// Reports every change until the exchange is dropped.
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

#[cfg(test)]
mod tests {
    use super::*;
    use tonic::Request;
    use tonic_health::pb::HealthCheckRequest;
    use tonic_health::pb::health_check_response::ServingStatus::{NotServing, Serving};
    use tonic_health::pb::health_server::Health as _;
    use tonic_health::server::HealthService;

    #[tokio::test]
    async fn a_failing_disk_is_reported_in_its_own_entry_until_it_recovers() {
        let reporter = HealthReporter::new();
        let health = HealthService::from_health_reporter(reporter.clone());
        let sender = watch::Sender::new(Storage::Sound);
        tokio::spawn(follow(sender.subscribe(), reporter));
        for (storage, expected) in [
            (Storage::Degraded, NotServing),
            (Storage::Sound, Serving),
            (Storage::Degraded, NotServing),
        ] {
            sender.send_replace(storage);
            loop {
                let request = HealthCheckRequest { service: STORAGE.to_owned() };
                let found = health.check(Request::new(request)).await;
                if found.is_ok_and(|found| found.into_inner().status() == expected) {
                    break;
                }
                tokio::task::yield_now().await;
            }
        }
    }
}
