//! Graph of neighbouring joints, as in Multi-Agent MuJoCo and Gymnasium-Robotics.

use std::collections::BTreeSet;

/// Joint graph of a robot.
#[derive(Debug)]
pub(crate) struct Neighbourhood {
    /// Joints of an edge have distance 1 from each other.
    pub(crate) edges: &'static [&'static [&'static str]],
    /// Bodies of the model whose contact forces belong to a joint.
    pub(crate) touching: &'static [(&'static str, &'static [&'static str])],
    /// Features of the global state that describe the root.
    pub(crate) globals: &'static [&'static str],
}

/// A chain from the back foot to the front foot.
pub(super) const HALFCHEETAH: Neighbourhood = Neighbourhood {
    edges: &[
        &["bfoot", "bshin"],
        &["bshin", "bthigh"],
        &["bthigh", "fthigh"],
        &["fthigh", "fshin"],
        &["fshin", "ffoot"],
    ],
    touching: &[],
    globals: PLANAR_ROOT,
};

/// A chain from the right foot to the left foot.
pub(super) const WALKER2D: Neighbourhood = Neighbourhood {
    edges: &[
        &["foot", "leg"],
        &["leg", "thigh"],
        &["thigh", "thigh_left"],
        &["thigh_left", "leg_left"],
        &["leg_left", "foot_left"],
    ],
    touching: &[],
    globals: PLANAR_ROOT,
};

/// All hips are connected by the torso.
pub(super) const ANT: Neighbourhood = Neighbourhood {
    edges: &[
        &["hip_1", "hip_2", "hip_3", "hip_4"],
        &["hip_1", "ankle_1"],
        &["hip_2", "ankle_2"],
        &["hip_3", "ankle_3"],
        &["hip_4", "ankle_4"],
    ],
    touching: &[
        ("hip_1", &["torso", "shoulder_1"]),
        ("hip_2", &["torso", "shoulder_2"]),
        ("hip_3", &["torso", "shoulder_3"]),
        ("hip_4", &["torso", "shoulder_4"]),
        ("ankle_1", &["shoulder_1", "thigh_1", "shank_1"]),
        ("ankle_2", &["shoulder_2", "thigh_2", "shank_2"]),
        ("ankle_3", &["shoulder_3", "thigh_3", "shank_3"]),
        ("ankle_4", &["shoulder_4", "thigh_4", "shank_4"]),
    ],
    globals: &[
        "root.z.position",
        "root.qw.position",
        "root.qx.position",
        "root.qy.position",
        "root.qz.position",
        "root.x.velocity",
        "root.y.velocity",
        "root.z.velocity",
        "root.wx.velocity",
        "root.wy.velocity",
        "root.wz.velocity",
    ],
};

const PLANAR_ROOT: &[&str] =
    &["rootz.position", "rooty.position", "rootx.velocity", "rootz.velocity", "rooty.velocity"];

impl Neighbourhood {
    /// Joints at distance 0, 1, ..., `reach` from `own`, each level sorted by name.
    pub(crate) fn levels<'a>(&self, own: &[&'a str], reach: usize) -> Vec<BTreeSet<&'a str>>
    where
        'static: 'a,
    {
        let mut levels: Vec<BTreeSet<&'a str>> = vec![own.iter().copied().collect()];
        let mut known = levels[0].clone();
        for _ in 0..reach {
            let last = levels.last().cloned().unwrap_or_default();
            let near =
                self.edges.iter().filter(|edge| edge.iter().any(|joint| last.contains(joint)));
            let next: BTreeSet<&str> =
                near.flat_map(|edge| edge.iter().copied()).filter(|j| !known.contains(j)).collect();
            known.extend(&next);
            levels.push(next);
        }
        levels
    }

    /// Bodies that belong to these joints, without duplicates, in the order of the joints.
    pub(crate) fn bodies(&self, joints: &BTreeSet<&str>) -> Vec<&'static str> {
        let mut bodies = Vec::new();
        for (_, touching) in self.touching.iter().filter(|(joint, _)| joints.contains(joint)) {
            for body in *touching {
                if !bodies.contains(body) {
                    bodies.push(*body);
                }
            }
        }
        bodies
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_follow_the_graph_without_repeated_joints() {
        let levels = ANT.levels(&["hip_4", "ankle_4"], 2);
        let names: Vec<Vec<&str>> =
            levels.iter().map(|level| level.iter().copied().collect()).collect();
        assert_eq!(names[0], ["ankle_4", "hip_4"]);
        assert_eq!(names[1], ["hip_1", "hip_2", "hip_3"]);
        assert_eq!(names[2], ["ankle_1", "ankle_2", "ankle_3"]);
        assert_eq!(ANT.bodies(&levels[0]), ["torso", "shoulder_4", "thigh_4", "shank_4"]);
    }
}
