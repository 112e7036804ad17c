//! Encoding of all agents' policies of one iteration, as the learner publishes them and a checkpoint stores them.

use std::collections::BTreeMap;

use sha2::{Digest, Sha256};

use crate::acting::{ActorPolicy, ActorSpec};
use crate::arrays::{NamedArrays, from_safetensors, places, to_safetensors};
use crate::error::PolicyError;
use crate::randomness::{Draw, RunSeed};

/// The metadata entry with the agents' specs as JSON.
const SPEC_KEY: &str = "s2mia.policy";
/// Shortest repeat, bytes. A shorter one costs about as much to name as to send.
const SHORTEST_REPEAT: usize = 256;
/// Maximum number of agents.
const MAX_AGENTS: usize = 1024;

/// Every agent's policy, in the order of the agents.
#[derive(Clone, Debug)]
pub struct PolicySnapshot {
    /// One policy per agent.
    pub agents: Vec<ActorPolicy>,
}

impl PolicySnapshot {
    /// A safetensors file: arrays `agent_I.NAME` with PyTorch's names and layout, specs as JSON in the metadata, and
    /// `input.*` for the standardisation of observations, if any. Equal policies have equal bytes.
    ///
    /// # Errors
    /// Passes on an array error.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PolicyError> {
        let specs: Vec<&ActorSpec> = self.agents.iter().map(ActorPolicy::spec).collect();
        let json = serde_json::to_string(&specs)
            .map_err(|error| PolicyError::Snapshot(format!("shapes: {error}")))?;
        let mut arrays = NamedArrays::new();
        for (i, agent) in self.agents.iter().enumerate() {
            let own = agent.arrays().iter();
            arrays.extend(own.map(|(name, array)| (format!("agent_{i}.{name}"), array.clone())));
        }
        Ok(to_safetensors(&arrays, &BTreeMap::from([(SPEC_KEY.to_owned(), json)]))?)
    }

    /// The signal `[K]` that all agents share in the step whose action has the key `action`; empty if they share none.
    #[must_use]
    pub fn signal(&self, seed: RunSeed, action: Draw) -> Vec<f32> {
        let noise = self.agents.first().and_then(|agent| agent.head().shared_noise());
        noise.map_or_else(Vec::new, |noise| noise.signal(seed, action))
    }

    /// Decodes [`PolicySnapshot::to_bytes`].
    ///
    /// # Errors
    /// If the format is wrong, the specs are missing, or an array is missing, unknown, of another shape or not
    /// finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PolicyError> {
        let (mut arrays, metadata) = from_safetensors(bytes)?;
        let json = metadata
            .get(SPEC_KEY)
            .ok_or_else(|| PolicyError::Snapshot(format!("no metadata entry {SPEC_KEY}")))?;
        let specs: Vec<ActorSpec> = serde_json::from_str(json)
            .map_err(|error| PolicyError::Snapshot(format!("{SPEC_KEY}: {error}")))?;
        if specs.is_empty() || specs.len() > MAX_AGENTS {
            let count = specs.len();
            return Err(PolicyError::Snapshot(format!(
                "{count} agents, expected 1 to {MAX_AGENTS}"
            )));
        }
        let mut agents = Vec::with_capacity(specs.len());
        for (i, spec) in specs.into_iter().enumerate() {
            agents.push(ActorPolicy::new(spec, take_agent(&mut arrays, i))?);
        }
        match arrays.keys().next() {
            None => Ok(Self { agents }),
            Some(name) => Err(PolicyError::Snapshot(format!("{name} belongs to no agent"))),
        }
    }
}

/// Moves the arrays of agent `index` out of `arrays` and removes their prefix.
fn take_agent(arrays: &mut NamedArrays, index: usize) -> NamedArrays {
    let prefix = format!("agent_{index}.");
    let names: Vec<String> =
        arrays.keys().filter(|name| name.starts_with(&prefix)).cloned().collect();
    let own = names.into_iter().filter_map(|name| arrays.remove_entry(&name));
    own.map(|(name, array)| (name[prefix.len()..].to_owned(), array)).collect()
}

/// Bytes of a snapshot that are equal to earlier ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repeat {
    /// Index of the first byte.
    pub at: usize,
    /// Index of the byte that is equal to the first.
    pub of: usize,
    /// Number of bytes.
    pub length: usize,
}

/// Parts of a snapshot in which later agents' arrays repeat the first agent's: agents that share a network. In the order of
/// the bytes, without short ones.
///
/// # Errors
/// If the bytes are not a safetensors file.
pub fn repeats(bytes: &[u8]) -> Result<Vec<Repeat>, PolicyError> {
    let places = places(bytes)?;
    let own = |name: &str| name.split_once('.').map(|(_, own)| own.to_owned());
    let first = places.iter().filter(|(name, _)| name.starts_with("agent_0."));
    let first = first.map(|(name, place)| (own(name), place)).collect::<BTreeMap<_, _>>();
    let mut found = Vec::<Repeat>::new();
    for (name, place) in &places {
        let Some(source) = first.get(&own(name)).filter(|source| source.end <= place.start) else {
            continue;
        };
        if bytes[(*source).clone()] != bytes[place.clone()] {
            continue;
        }
        match found.last_mut() {
            Some(last)
                if (last.at + last.length, last.of + last.length)
                    == (place.start, source.start) =>
            {
                last.length += place.len();
            }
            _ => found.push(Repeat { at: place.start, of: source.start, length: place.len() }),
        }
    }
    found.retain(|repeat| repeat.length >= SHORTEST_REPEAT);
    Ok(found)
}

/// SHA-256 of a snapshot's bytes, its identity in messages.
#[must_use]
pub fn digest(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}
