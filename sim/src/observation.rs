//! Layout and scaling of an agent's observation.
//!
//! In `full_id`, agent `i` of `n` observes the global state followed by the one-hot index `i`. `feature_z` standardises
//! this vector by the mean `m` and standard deviation `s` over its **own** features, including the index, as the
//! published code does. This has two consequences. First, the one-hot part adds one 1 and `n - 1` zeros for every `i`.
//! `m`, `s` and all signal features are therefore the same for every agent, bit for bit: the sums run over the signals,
//! and the index is added in closed form. Second, the entries of the index are `(1 - m) / s` and `-m / s` instead of 1
//! and 0. They vary with the state, and because they determine `m` and `s`, no information is lost. They are still
//! declared as `Identity`, so densities exclude them.

use proto::{FeatureRole, FeatureSpec};

use crate::config::{ContactForces, ObservationConfig, ObservationMode, ObservationNorm, RootView};
use crate::robot::{Actuator, Robot};

/// Below this standard deviation, a vector is only centred.
const SMALLEST_DEVIATION: f64 = 1e-8;
/// Names of a body's six contact features, in the order of the model.
const CONTACT_NAMES: [&str; 6] =
    ["torque.x", "torque.y", "torque.z", "force.x", "force.y", "force.z"];

/// The layout of a task's observations.
#[derive(Clone, Debug)]
pub(crate) struct Observation {
    norm: ObservationNorm,
    agents: usize,
    view: ObservedFeatures,
}

/// The global state, and which of its features agents may observe.
pub(crate) struct GlobalState {
    pub(crate) features: Vec<FeatureSpec>,
    /// Number of first features that agents in `full_id` observe.
    pub(crate) observed: usize,
    /// Indices of the features that agents in `k_nearest` observe besides their neighbourhood.
    pub(crate) shared: Vec<usize>,
    /// Indices of the features that relate bodies, each with the tree whose agents observe it in `k_nearest`, or none.
    pub(crate) related: Vec<(usize, Option<usize>)>,
}

#[derive(Clone, Debug)]
enum ObservedFeatures {
    /// This number of features of the global state, then the agent's one-hot index.
    Whole(usize),
    /// Per agent, indices in the global state; `None` is padding.
    Places(Vec<Vec<Option<usize>>>),
}

/// Contact-force features of the global state; empty if they are absent.
pub(crate) fn contact_features(robot: &Robot, forces: ContactForces) -> Vec<FeatureSpec> {
    if forces == ContactForces::Absent {
        return Vec::new();
    }
    let role = FeatureRole::Constant;
    let of_body = |body: &String| {
        CONTACT_NAMES.map(|part| FeatureSpec { name: contact_name(body, part), role })
    };
    robot.bodies().iter().flat_map(of_body).collect()
}

fn contact_name(body: &str, part: &str) -> String {
    format!("contact.{body}.{part}")
}

impl Observation {
    /// `agents` contains the motors of each agent.
    pub(crate) fn new(
        config: &ObservationConfig,
        robot: &Robot,
        agents: &[Vec<usize>],
        state: &GlobalState,
    ) -> Self {
        let view = match config.mode {
            ObservationMode::FullId => ObservedFeatures::Whole(state.observed),
            ObservationMode::KNearest => ObservedFeatures::Places(padded(
                agents.iter().map(|own| near(config, robot, own, state)).collect(),
            )),
        };
        Self { norm: config.norm, agents: agents.len(), view }
    }

    /// Features of an agent's observation, given those of the global state.
    pub(crate) fn features(&self, agent: usize, state: &[FeatureSpec]) -> Vec<FeatureSpec> {
        match &self.view {
            ObservedFeatures::Whole(observed) => {
                let number = (0..self.agents)
                    .map(|k| FeatureSpec { name: format!("id.{k}"), role: FeatureRole::Identity });
                state[..*observed].iter().cloned().chain(number).collect()
            }
            ObservedFeatures::Places(agents) => {
                let padding =
                    || FeatureSpec { name: "padding".into(), role: FeatureRole::Constant };
                let feature =
                    |place: &Option<usize>| place.map_or_else(padding, |at| state[at].clone());
                agents[agent].iter().map(feature).collect()
            }
        }
    }

    /// Indices in the global state of the features that an agent observes.
    pub(crate) fn seen(&self, agent: usize) -> Vec<usize> {
        match &self.view {
            ObservedFeatures::Whole(observed) => (0..*observed).collect(),
            ObservedFeatures::Places(agents) => agents[agent].iter().copied().flatten().collect(),
        }
    }

    /// Writes the observation of `agent`, given the global state.
    pub(crate) fn see(&self, agent: usize, state: &[f32], out: &mut [f32]) {
        match &self.view {
            ObservedFeatures::Whole(observed) => {
                out[..*observed].copy_from_slice(&state[..*observed]);
                out[*observed..].fill(0.0);
                out[*observed + agent] = 1.0;
                if self.norm == ObservationNorm::FeatureZ {
                    standardise_with_number(out, *observed);
                }
            }
            ObservedFeatures::Places(agents) => {
                let places = &agents[agent];
                for (to, place) in out.iter_mut().zip(places) {
                    *to = place.map_or(0.0, |at| state[at]);
                }
                if self.norm == ObservationNorm::FeatureZ {
                    let seen = places.iter().filter(|place| place.is_some()).count();
                    standardise(&mut out[..seen]);
                }
            }
        }
    }
}

/// Indices in the global state of an agent's local observation: angles, speeds and contacts of its own joints, then the
/// angles of other joints by increasing distance, then the root, other bodies as its own robot sees them, and what all agents
/// share. Features of another robot's root, one whose tree has motors, are not local.
pub(crate) fn near(
    config: &ObservationConfig,
    robot: &Robot,
    motors: &[usize],
    state: &GlobalState,
) -> Vec<usize> {
    let neighbourhood = &robot.neighbourhood;
    let actuators: Vec<Actuator<'_>> = robot.actuators().collect();
    let own = motors.iter().flat_map(|&motor| &actuators[motor].moved).copied();
    let levels = neighbourhood.levels(&own.collect::<Vec<&str>>(), config.nearest);
    let mut names: Vec<String> = Vec::new();
    let feature = |kind: &'static str| move |name: &String| format!("{name}.{kind}");
    for joint in &levels[0] {
        names.extend(robot.numbers_of(joint)[0].iter().map(feature("position")));
    }
    for joint in &levels[0] {
        names.extend(robot.numbers_of(joint)[1].iter().map(feature("velocity")));
    }
    if config.contact_forces != ContactForces::Absent {
        let bodies = neighbourhood.bodies(&levels[0]);
        let of_body = |body: &str| CONTACT_NAMES.map(|part| contact_name(body, part));
        names.extend(bodies.into_iter().flat_map(of_body));
    }
    for joint in levels[1..].iter().flatten() {
        names.extend(robot.numbers_of(joint)[0].iter().map(feature("position")));
    }
    let (own_trees, driven) = (robot.trees_of(motors.iter().copied()), robot.driven_trees());
    let is_near = |tree: &usize| own_trees.contains(tree) || !driven.contains(tree);
    if config.globals == RootView::Shown {
        let globals = neighbourhood.globals.iter();
        let is_near = |name: &str| robot.tree_of_feature(name).as_ref().is_none_or(is_near);
        let is_new = |name: &&String| is_near(name) && !names.contains(name);
        let new: Vec<String> = globals.filter(is_new).cloned().collect();
        names.extend(new);
    }
    let place = |name: &String| state.features.iter().position(|feature| feature.name == *name);
    // Hidden coordinates are no features; other names were checked.
    let places: Vec<usize> = names.iter().filter_map(place).collect();
    let related = state.related.iter().filter(|(place, _)| !places.contains(place));
    let related = related.filter(|(_, observer)| observer.as_ref().is_none_or(is_near));
    let related: Vec<usize> = related.map(|(place, _)| *place).collect();
    [places, related, state.shared.clone()].concat()
}

/// Pads all lists to the length of the longest.
fn padded(agents: Vec<Vec<usize>>) -> Vec<Vec<Option<usize>>> {
    let longest = agents.iter().map(Vec::len).max().unwrap_or(0);
    let filled = |places: Vec<usize>| {
        let padding = std::iter::repeat_n(None, longest - places.len());
        places.into_iter().map(Some).chain(padding).collect()
    };
    agents.into_iter().map(filled).collect()
}

/// Standardises a vector by the mean `m` and standard deviation `s` over its features, `(x - m) / s`:
/// [`ObservationNorm::FeatureZ`] for observations of other programs.
pub fn standardise(out: &mut [f32]) {
    let count = out.len() as f64;
    let mean = out.iter().map(|&x| f64::from(x)).sum::<f64>() / count;
    let variance = out.iter().map(|&x| square(f64::from(x) - mean)).sum::<f64>() / count;
    scale(out, mean, variance);
}

/// Standardises a vector with a one-hot index, whose sums are computed in closed form: `(x - m) / s`.
fn standardise_with_number(out: &mut [f32], signals: usize) {
    let count = out.len() as f64;
    let zeros = (out.len() - signals - 1) as f64;
    let sum: f64 = out[..signals].iter().map(|&x| f64::from(x)).sum();
    let mean = (sum + 1.0) / count;
    let squares: f64 = out[..signals].iter().map(|&x| square(f64::from(x) - mean)).sum();
    let variance = (squares + square(1.0 - mean) + zeros * square(mean)) / count;
    scale(out, mean, variance);
}

fn scale(out: &mut [f32], mean: f64, variance: f64) {
    let deviation = variance.sqrt().max(SMALLEST_DEVIATION);
    for x in out {
        *x = ((f64::from(*x) - mean) / deviation) as f32;
    }
}

fn square(x: f64) -> f64 {
    x * x
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observe(norm: ObservationNorm, agent: usize) -> [f32; 5] {
        let mut out = [9.0; 5];
        Observation { norm, agents: 2, view: ObservedFeatures::Whole(3) }.see(
            agent,
            &[3.0, -1.0, 2.0],
            &mut out,
        );
        out
    }

    #[test]
    fn without_scaling_an_observation_is_the_state_followed_by_the_index() {
        assert_eq!(observe(ObservationNorm::None, 1), [3.0, -1.0, 2.0, 0.0, 1.0]);
    }

    #[test]
    fn an_observation_is_standardised_over_its_own_features() {
        // 3, -1, 2, 1, 0: mean 1, variance (4 + 4 + 1 + 0 + 1) / 5 = 2.
        let s = std::f32::consts::FRAC_1_SQRT_2;
        let expected = [2.0 * s, -2.0 * s, s, 0.0, -s];
        for (got, want) in observe(ObservationNorm::FeatureZ, 0).iter().zip(expected) {
            assert!((got - want).abs() < 1e-6);
        }
    }

    #[test]
    fn a_local_observation_copies_its_features_and_pads_with_zeros() {
        let view = ObservedFeatures::Places(vec![vec![Some(2), Some(0)], vec![Some(1), None]]);
        let observation = Observation { norm: ObservationNorm::FeatureZ, agents: 2, view };
        let (mut first, mut second) = ([9.0; 2], [9.0; 2]);
        observation.see(0, &[3.0, -1.0, 2.0], &mut first);
        observation.see(1, &[3.0, -1.0, 2.0], &mut second);
        assert_eq!((first, second), ([-1.0, 1.0], [0.0, 0.0]));
    }

    #[test]
    fn signals_are_bit_identical_for_every_agent() {
        let (first, second) =
            (observe(ObservationNorm::FeatureZ, 0), observe(ObservationNorm::FeatureZ, 1));
        assert_eq!(first[..3], second[..3]);
        assert_eq!(first[3], second[4]);
    }
}
