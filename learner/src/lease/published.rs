//! One version of all agents' policies: the bytes that travel, and what they hold.

use bytes::Bytes;
use policy::snapshot::{Repeat, repeats};
use policy::{ActorPolicy, Head, PolicySnapshot};
use proto::{AgentSpec, Digest, PolicyVersion, WeightsName};

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
        let sizes = |policy: &ActorPolicy| {
            let choices = match policy.head() {
                Head::Categorical { choices } => Some(choices),
                Head::Gaussian | Head::Deterministic { .. } | Head::Uniform { .. } => None,
            };
            (policy.observation_size(), policy.action_size(), choices, policy.hidden_size())
        };
        let found = policy.agents.iter().map(sizes).collect::<Vec<_>>();
        let expected = agents.iter().zip(hidden_sizes).map(|(agent, hidden)| {
            let choices = agent.action.choices.map(|choices| choices as usize);
            (agent.observation.len(), agent.action.size, choices, *hidden as usize)
        });
        let expected = expected.collect::<Vec<_>>();
        if found != expected {
            return Err(format!(
                "the agents' (observation, action, choices, hidden) sizes are {found:?}, the run has \
                 {expected:?}"
            ));
        }
        let repeats = repeats(&bytes).map_err(|error| error.to_string())?;
        let digest = Digest(policy::digest(&bytes));
        Ok(Self { name: WeightsName { version, digest }, bytes, repeats, policy })
    }
}
