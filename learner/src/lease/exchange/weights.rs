//! Published weights that are still held: those just published, and those that open work names.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use proto::{PolicyVersion, Reason, Refusal, WeightsName};

use crate::lease::published::Published;

/// Versions kept although no open work names them: the one just published, and the one before it.
const LATEST: usize = 2;

/// Published versions that are still held.
#[derive(Debug, Default)]
pub(super) struct Weights {
    held: BTreeMap<PolicyVersion, Arc<Published>>,
    latest: VecDeque<PolicyVersion>,
}

impl Weights {
    pub(super) fn insert(&mut self, published: Published) {
        let version = published.name.version;
        self.held.insert(version, Arc::new(published));
        self.latest.retain(|other| *other != version);
        self.latest.push_back(version);
        if self.latest.len() > LATEST {
            self.latest.pop_front();
        }
    }

    /// Drops what is neither recent nor named by open work.
    pub(super) fn prune(&mut self, in_use: impl Iterator<Item = WeightsName>) {
        let in_use = in_use.map(|name| name.version).collect::<BTreeSet<_>>();
        let latest = &self.latest;
        self.held.retain(|version, _| in_use.contains(version) || latest.contains(version));
    }

    /// The newest version, which there is once an iteration has been opened.
    pub(super) fn newest(&self) -> Option<PolicyVersion> {
        self.held.keys().next_back().copied()
    }

    /// Size of the newest version.
    pub(super) fn newest_bytes(&self) -> u64 {
        self.held.values().next_back().map_or(0, |newest| newest.bytes.len() as u64)
    }

    pub(super) fn find(&self, name: WeightsName) -> Result<Arc<Published>, Refusal> {
        let held = self.held.get(&name.version).filter(|held| held.name == name);
        held.cloned().ok_or_else(|| {
            let detail =
                format!("version {} with SHA-256 {} is not held", name.version, name.digest);
            Refusal::new(Reason::UnknownWeights, "weights", detail)
        })
    }

    /// The name of a version that the trainer has published.
    pub(super) fn expect(&self, version: PolicyVersion) -> WeightsName {
        let held = self.held.keys().collect::<Vec<_>>();
        let published = self.held.get(&version);
        published.unwrap_or_else(|| panic!("weights {version} are not held, only {held:?}")).name
    }
}
