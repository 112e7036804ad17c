//! Assigns actuators to agents.

use crate::config::PartitionSemantics;

/// Actuators of each agent, as indices of the robot's motors, in the order of the agent's action.
///
/// `labels` are the published joint names of each agent. [`PartitionSemantics::ActuatorSlices`] uses only their
/// counts: the published code concatenates the agents' actions and passes them to the actuators in order, regardless of
/// the labels.
pub(crate) fn partition(
    labels: &[Vec<String>],
    actuators: &[&str],
    semantics: PartitionSemantics,
) -> Vec<Vec<usize>> {
    match semantics {
        PartitionSemantics::ActuatorSlices => {
            let mut all = 0..actuators.len();
            labels.iter().map(|joints| all.by_ref().take(joints.len()).collect()).collect()
        }
        PartitionSemantics::Labels => labels
            .iter()
            .map(|joints| joints.iter().map(|joint| position(actuators, joint)).collect())
            .collect(),
    }
}

fn position(actuators: &[&str], joint: &str) -> usize {
    actuators
        .iter()
        .position(|name| *name == joint)
        .expect("a task's labels name actuators of its robot, which `Task` checks")
}

#[cfg(test)]
mod tests {
    use super::*;

    const ACTUATORS: &[&str] = &["hip", "knee", "toe", "tail"];
    const LABELS: [[&str; 2]; 2] = [["toe", "hip"], ["tail", "knee"]];

    #[test]
    fn slices_follow_the_actuators_and_labels_follow_the_names() {
        let labels = LABELS.map(|joints| joints.map(str::to_owned).to_vec());
        let slices = partition(&labels, ACTUATORS, PartitionSemantics::ActuatorSlices);
        assert_eq!(slices, [[0, 1], [2, 3]]);
        let labels = partition(&labels, ACTUATORS, PartitionSemantics::Labels);
        assert_eq!(labels, [[2, 0], [3, 1]]);
    }
}
