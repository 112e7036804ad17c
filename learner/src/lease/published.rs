//! Published versions of all agents' policies: the bytes that travel and what they hold, and which versions are held.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use bytes::Bytes;
use policy::snapshot::{Repeat, repeats};
use policy::{ActorPolicy, PolicySnapshot};
use proto::{AgentSpec, Digest, PolicyVersion, Reason, Refusal, WeightsName};

/// Versions kept although no open work names them: the one just published, and the one before it.
const LATEST: usize = 2;

/// One version.
#[derive(Debug)]
pub struct Published {
    /// Its version, and the digest of its bytes.
    pub name: WeightsName,
    /// A `policy::PolicySnapshot` as it travels.
    pub bytes: Bytes,
    /// Parts of the bytes that repeat earlier ones.
    pub repeats: Vec<Repeat>,
    /// The same, to act by.
    pub policy: PolicySnapshot,
}

impl Published {
    /// Parses a snapshot and compares its sizes with those of the team, whose recurrent states have `hidden_sizes`.
    ///
    /// # Errors
    /// Says what is wrong with the bytes, or both sides' sizes.
    pub fn parse(
        version: PolicyVersion,
        bytes: Bytes,
        agents: &[AgentSpec],
        hidden_sizes: &[u32],
    ) -> Result<Self, String> {
        let policy = PolicySnapshot::from_bytes(&bytes).map_err(|error| error.to_string())?;
        demand_sizes(&policy, agents, hidden_sizes)?;
        let repeats = repeats(&bytes).map_err(|error| error.to_string())?;
        let digest = Digest(policy::digest(&bytes));
        Ok(Self { name: WeightsName { version, digest }, bytes, repeats, policy })
    }
}

/// Compares the sizes of policies with those of the team, whose recurrent states have `hidden_sizes`.
///
/// # Errors
/// Says both sides' sizes.
pub fn demand_sizes(
    policy: &PolicySnapshot,
    agents: &[AgentSpec],
    hidden_sizes: &[u32],
) -> Result<(), String> {
    let sizes = |policy: &ActorPolicy| {
        let choices = policy.head().choices();
        (policy.observation_size(), policy.action_size(), choices, policy.hidden_size())
    };
    let found = policy.agents.iter().map(sizes).collect::<Vec<_>>();
    let expected = agents.iter().zip(hidden_sizes).map(|(agent, hidden)| {
        let choices = agent.action.choices.map(|choices| choices as usize);
        (agent.observation.len(), agent.action.size, choices, *hidden as usize)
    });
    let expected = expected.collect::<Vec<_>>();
    if found == expected {
        return Ok(());
    }
    Err(format!(
        "the agents' (observation, action, choices, hidden) sizes are {found:?}, the run has {expected:?}"
    ))
}

/// Published versions that are still held.
#[derive(Debug, Default)]
pub(crate) struct PublishedVersions {
    held: BTreeMap<PolicyVersion, Arc<Published>>,
    latest: VecDeque<PolicyVersion>,
}

impl PublishedVersions {
    pub(crate) fn insert(&mut self, published: Published) {
        let version = published.name.version;
        self.held.insert(version, Arc::new(published));
        self.latest.retain(|other| *other != version);
        self.latest.push_back(version);
        if self.latest.len() > LATEST {
            self.latest.pop_front();
        }
    }

    /// Drops what is neither recent nor named by open work.
    pub(crate) fn prune(&mut self, in_use: impl Iterator<Item = WeightsName>) {
        let in_use = in_use.map(|name| name.version).collect::<BTreeSet<_>>();
        let latest = &self.latest;
        self.held.retain(|version, _| in_use.contains(version) || latest.contains(version));
    }

    /// The newest version, which there is once an iteration has been opened.
    pub(crate) fn newest(&self) -> Option<PolicyVersion> {
        self.held.keys().next_back().copied()
    }

    /// Size of the newest version.
    pub(crate) fn newest_bytes(&self) -> u64 {
        self.held.values().next_back().map_or(0, |newest| newest.bytes.len() as u64)
    }

    pub(crate) fn find(&self, name: WeightsName) -> Result<Arc<Published>, Refusal> {
        let held = self.held.get(&name.version).filter(|held| held.name == name);
        held.cloned().ok_or_else(|| {
            let detail =
                format!("version {} with SHA-256 {} is not held", name.version, name.digest);
            Refusal::new(Reason::UnknownWeights, "weights", detail)
        })
    }

    /// The name of a version that the trainer has published.
    pub(crate) fn expect(&self, version: PolicyVersion) -> WeightsName {
        let held = self.held.keys().collect::<Vec<_>>();
        let published = self.held.get(&version);
        published.unwrap_or_else(|| panic!("weights {version} are not held, only {held:?}")).name
    }
}
