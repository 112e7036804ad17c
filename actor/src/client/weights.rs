//! Policy snapshots that the threads of an actor process share.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use policy::PolicySnapshot;
use proto::WeightsName;
use tokio::sync::OnceCell;

use crate::error::ActorError;

/// Largest number of cached snapshots.
const KEPT_WEIGHTS: usize = 3;

/// A snapshot, once it has been fetched.
type Cell = Arc<OnceCell<Arc<PolicySnapshot>>>;

/// Cache of the latest policy snapshots.
#[derive(Default)]
pub(crate) struct WeightsCache {
    latest: Mutex<VecDeque<(WeightsName, Cell)>>,
}

impl WeightsCache {
    /// Returns the snapshot `name`. Completes `fetch` if the snapshot is not cached. Concurrent callers with the same
    /// name wait for one `fetch`; if it fails, the next of them completes its own.
    pub(super) async fn get(
        &self,
        name: WeightsName,
        fetch: impl Future<Output = Result<Arc<PolicySnapshot>, ActorError>>,
    ) -> Result<Arc<PolicySnapshot>, ActorError> {
        self.cell(name).get_or_try_init(|| fetch).await.cloned()
    }

    fn cell(&self, name: WeightsName) -> Cell {
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, cell)) = latest.iter().find(|(cached, _)| *cached == name) {
            return Arc::clone(cell);
        }
        let cell = Cell::default();
        latest.push_back((name, Arc::clone(&cell)));
        if latest.len() > KEPT_WEIGHTS {
            latest.pop_front();
        }
        cell
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use proto::{Digest, PolicyVersion};
    use tokio::sync::Notify;
    use tonic::Status;

    use super::*;

    fn policy() -> PolicySnapshot {
        PolicySnapshot { agents: Vec::new() }
    }

    fn name(version: u64) -> WeightsName {
        WeightsName { version: PolicyVersion(version), digest: Digest([7; 32]) }
    }

    #[tokio::test]
    async fn threads_that_need_the_same_snapshot_fetch_it_once() {
        let (cache, fetched, arrived) = (WeightsCache::default(), AtomicU64::new(0), Notify::new());
        let get = || {
            cache.get(name(1), async {
                fetched.fetch_add(1, Ordering::Relaxed);
                arrived.notified().await;
                Ok(Arc::new(policy()))
            })
        };
        let arrive = async { arrived.notify_one() };
        let (first, second, ()) = tokio::join!(get(), get(), arrive);
        assert!(Arc::ptr_eq(&first.unwrap(), &second.unwrap()));
        assert_eq!(fetched.load(Ordering::Relaxed), 1);
    }

    #[tokio::test]
    async fn the_latest_snapshots_are_kept_and_a_failed_fetch_is_repeated() {
        let cache = WeightsCache::default();
        let away = async || Err(Status::unavailable("not cached").into());
        assert!(cache.get(name(0), away()).await.is_err());
        for version in 0..=KEPT_WEIGHTS as u64 {
            cache.get(name(version), async { Ok(Arc::new(policy())) }).await.unwrap();
        }
        assert!(cache.get(name(0), away()).await.is_err(), "the oldest one was dropped");
        assert!(cache.get(name(KEPT_WEIGHTS as u64), away()).await.is_ok());
    }
}
