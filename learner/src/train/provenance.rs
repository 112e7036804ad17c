//! `provenance.jsonl`: one line per iteration with the slots of its rollouts, the actors that computed them, and the
//! hashes of the new weights. It is never read back into a run.

use std::path::Path;

use policy::arrays::{NamedArrays, hex, sha256};
use proto::WeightsName;
use serde_json::{Value, json};

use crate::lease::slots::SlotRollout;
use crate::store::durable::FileError;
use crate::store::json_lines::JsonLines;
use crate::store::run_folder::PROVENANCE;

/// Key of the environments that began a new episode because theirs could not be continued. The iteration is no function of
/// the configuration and seed then.
pub const BEGUN_AGAIN: &str = "begun_again";

/// The provenance of a run, open for more.
#[derive(Debug)]
pub(crate) struct Provenance {
    lines: JsonLines,
}

/// Where one iteration's weights come from.
#[derive(Debug)]
pub(crate) struct WeightsOrigin<'a> {
    /// Finished iterations, this one included.
    pub(crate) iteration: u64,
    /// The weights with which actors rolled out.
    pub(crate) behaviour: WeightsName,
    /// Environments that began a new episode because theirs could not be continued.
    pub(crate) begun_again: &'a [u32],
    /// What they rolled out.
    pub(crate) rollouts: &'a [SlotRollout],
    /// The densities fitted on it, `theta_k`.
    pub(crate) density: &'a NamedArrays,
    /// Hash of the new weights, hexadecimal.
    pub(crate) weights_sha256: &'a str,
    /// The algorithm's figures; the places of the agents in the sweep are taken from them.
    pub(crate) report: &'a [(String, f64)],
}

impl Provenance {
    /// Opens the provenance of a run that resumes after `iteration`; later lines are dropped.
    ///
    /// # Errors
    /// Names the file if it cannot be read or written.
    pub(crate) fn open(run_folder: &Path, iteration: u64) -> Result<Self, FileError> {
        let (lines, _) = JsonLines::cut(&run_folder.join(PROVENANCE), iteration)?;
        Ok(Self { lines })
    }

    /// Adds an iteration.
    ///
    /// # Errors
    /// Names the file if it cannot be written.
    pub(crate) fn iteration(&mut self, origin: &WeightsOrigin<'_>) -> Result<(), FileError> {
        let mut line = json!({
            "iteration": origin.iteration,
            "behaviour": {
                "version": origin.behaviour.version.0,
                "digest": origin.behaviour.digest.to_string(),
            },
            "slots": origin.rollouts.iter().map(slot).collect::<Vec<Value>>(),
            "order": order(origin.report),
            "density_sha256": hex(&sha256(origin.density)),
            "weights_sha256": origin.weights_sha256,
        });
        if !origin.begun_again.is_empty() {
            line[BEGUN_AGAIN] = json!(origin.begun_again);
        }
        self.lines.append(&line)
    }

    /// Waits until the disk has all lines.
    ///
    /// # Errors
    /// Names the file if it cannot be flushed.
    pub(crate) fn sync(&mut self) -> Result<(), FileError> {
        self.lines.sync()
    }
}

fn slot(rollout: &SlotRollout) -> Value {
    let digests: Vec<String> = rollout.digests.iter().map(ToString::to_string).collect();
    json!({
        "slot": rollout.slot,
        "environments": rollout.environments(),
        "actor": rollout.actor.0,
        "lease": rollout.lease.0,
        "digests": digests,
    })
}

/// Agents in the order in which the sweep updated them; empty if the algorithm reports none.
fn order(report: &[(String, f64)]) -> Vec<usize> {
    let place = |(name, place): &(String, f64)| {
        let agent = name.strip_prefix("agent")?.strip_suffix("/sweep_position")?.parse().ok()?;
        Some((*place as usize, agent))
    };
    let mut places: Vec<(usize, usize)> = report.iter().filter_map(place).collect();
    places.sort_unstable();
    places.into_iter().map(|(_, agent)| agent).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_of_the_sweep_is_read_from_the_agents_places() {
        let report = [
            ("agent0/sweep_position", 2.0),
            ("agent1/sweep_position", 0.0),
            ("agent1/sigma", 0.3),
            ("agent2/sweep_position", 1.0),
        ];
        let report: Vec<(String, f64)> =
            report.map(|(name, place)| (name.to_owned(), place)).into();
        assert_eq!(order(&report), [1, 2, 0]);
        assert_eq!(order(&[]), [0_usize; 0]);
    }
}
