//! Graph of neighbouring joints, as in Multi-Agent MuJoCo and Gymnasium-Robotics.

use std::collections::BTreeSet;

use serde::Deserialize;

use super::Robot;

/// Joint graph of a robot.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Neighbourhood {
    /// Joints of an edge have distance 1 from each other.
    pub(crate) edges: Vec<Vec<String>>,
    /// Bodies of the model whose contact forces belong to a joint.
    pub(crate) touching: Vec<JointBodies>,
    /// Features of the global state that describe the root.
    pub(crate) globals: Vec<String>,
}

/// Bodies of a joint.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct JointBodies {
    pub(crate) joint: String,
    pub(crate) bodies: Vec<String>,
}

impl Neighbourhood {
    /// Joints at distance 0, 1, ..., at most `reach` from `own`, each level sorted by name; none is empty but the first.
    pub(crate) fn levels<'a>(&'a self, own: &[&'a str], reach: usize) -> Vec<BTreeSet<&'a str>> {
        let mut levels: Vec<BTreeSet<&str>> = vec![own.iter().copied().collect()];
        let mut known = levels[0].clone();
        for _ in 0..reach {
            let last = levels.last().cloned().unwrap_or_default();
            let near = self
                .edges
                .iter()
                .filter(|edge| edge.iter().any(|joint| last.contains(joint.as_str())));
            let joints = near.flatten().map(String::as_str);
            let next: BTreeSet<&str> = joints.filter(|joint| !known.contains(joint)).collect();
            if next.is_empty() {
                break;
            }
            known.extend(&next);
            levels.push(next);
        }
        levels
    }

    /// Bodies that belong to these joints, without duplicates, in the order of the joints.
    pub(crate) fn bodies(&self, joints: &BTreeSet<&str>) -> Vec<&str> {
        let mut bodies: Vec<&str> = Vec::new();
        let of = self.touching.iter().filter(|row| joints.contains(row.joint.as_str()));
        for body in of.flat_map(|row| &row.bodies) {
            if !bodies.contains(&body.as_str()) {
                bodies.push(body);
            }
        }
        bodies
    }
}

impl Robot {
    /// The tree of a body, by its first link; `None` for a fixed body.
    pub(crate) fn tree_of_body(&self, body: usize) -> Option<usize> {
        let (link, _) = self.blueprint.homes[body];
        link.map(|link| self.blueprint.tree_of(link))
    }

    /// The tree of a measured feature of the state, if it is a coordinate or velocity of a joint.
    pub(crate) fn tree_of_feature(&self, feature: &str) -> Option<usize> {
        let (name, kind) = feature.rsplit_once('.')?;
        let index = |names: &[String]| names.iter().position(|own| own == name);
        let mut joints = self.layout.joints.iter();
        let link = match kind {
            "position" => {
                let index = index(&self.layout.coordinate_names)?;
                joints.rposition(|joint| joint.coordinate <= index)
            }
            _ => {
                let index = index(&self.layout.velocity_names)?;
                joints.rposition(|joint| joint.velocity <= index)
            }
        };
        link.map(|link| self.blueprint.tree_of(link))
    }

    /// The trees that these motors move.
    pub(crate) fn trees_of(&self, motors: impl IntoIterator<Item = usize>) -> BTreeSet<usize> {
        let blueprint = &self.blueprint;
        let moved =
            motors.into_iter().flat_map(|motor| blueprint.links_of(&blueprint.motors[motor]));
        moved.map(|link| blueprint.tree_of(link)).collect()
    }

    /// The trees that have motors.
    pub(crate) fn driven_trees(&self) -> BTreeSet<usize> {
        self.trees_of(0..self.blueprint.motors.len())
    }
}

#[cfg(test)]
mod tests {
    use crate::robot::Robot;

    #[test]
    fn levels_follow_the_graph_without_repeated_joints() {
        let ant = Robot::of_task("ant-4x2").unwrap();
        let ant = &ant.neighbourhood;
        let levels = ant.levels(&["hip_4", "ankle_4"], 2);
        let names: Vec<Vec<&str>> =
            levels.iter().map(|level| level.iter().copied().collect()).collect();
        assert_eq!(names[0], ["ankle_4", "hip_4"]);
        assert_eq!(names[1], ["hip_1", "hip_2", "hip_3"]);
        assert_eq!(names[2], ["ankle_1", "ankle_2", "ankle_3"]);
        // All eight joints are within two edges.
        assert_eq!(ant.levels(&["hip_4", "ankle_4"], usize::MAX), levels);
        assert_eq!(ant.bodies(&levels[0]), ["torso", "shoulder_4", "thigh_4", "shank_4"]);
    }
}
