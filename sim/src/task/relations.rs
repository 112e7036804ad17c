//! Features of the global state that relate bodies to each other: where an object is from a robot, a target from an object.

use std::collections::BTreeSet;
use std::fmt;

use rapier3d::glamx::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::Motion;
use super::definition::{Axes, refused};
use super::names::Names;
use crate::error::SimError;
use crate::robot::{Place, PlaceMotion, Robot};

/// Largest number of rows.
const MOST_ROWS: usize = 1000;

/// Ends of the features' names: as what they are measured.
const KINDS: [&str; 2] = ["position", "velocity"];

/// A row of `[[state.bodies]]`: a body as it is seen from another one.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RelationRow {
    of: String,
    /// The observing body; absent: the world.
    from: Option<String>,
    /// Absent: position and velocity.
    features: Option<Vec<Relation>>,
    /// Components of vectors; absent: all.
    along: Option<Vec<WorldAxis>>,
    /// Axes of vectors; absent: those of the observing body.
    axes: Option<Axes>,
}

/// What a row observes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
enum Relation {
    /// From origin to origin, m.
    Position,
    /// Difference of the velocities of the origins, m/s.
    Velocity,
    /// Quaternion w x y z from the axes of the observing body to those of the body, with `w >= 0`.
    Orientation,
    /// Difference of the angular velocities, rad/s.
    AngularVelocity,
}

/// An axis x, y or z.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum WorldAxis {
    X,
    Y,
    Z,
}

/// The rows of a task, with names resolved.
#[derive(Clone, Debug)]
pub(super) struct Relations(Vec<Observed>);

/// A row.
#[derive(Clone, Debug)]
struct Observed {
    /// `OF/FROM`.
    name: String,
    of: Place,
    from: Place,
    features: Vec<Relation>,
    /// Components of vectors.
    along: Vec<usize>,
    axes: Axes,
    /// The tree of the observing body, if it has a motor.
    observer: Option<usize>,
}

/// A feature.
pub(crate) struct RelationFeature {
    pub(crate) name: String,
    /// The tree whose agents observe it if observations are local; `None` if all agents do.
    pub(crate) observer: Option<usize>,
}

impl Relations {
    pub(super) fn new(rows: &[RelationRow], robot: &Robot) -> Result<Self, SimError> {
        if rows.len() > MOST_ROWS {
            let rows = rows.len();
            return Err(refused(format!(
                "state.bodies has {rows} rows; at most {MOST_ROWS} are allowed"
            )));
        }
        let rows = rows.iter().map(|row| Observed::new(row, robot));
        let relations = Self(rows.collect::<Result<_, _>>()?);
        let mut names = BTreeSet::new();
        for RelationFeature { name, .. } in relations.features().into_iter().flatten() {
            if !names.insert(name.clone()) {
                return Err(refused(format!("state.bodies states the feature `{name}` twice")));
            }
        }
        Ok(relations)
    }

    /// The features that are measured as positions, and those that are measured as velocities.
    pub(super) fn features(&self) -> [Vec<RelationFeature>; 2] {
        let mut features = [Vec::new(), Vec::new()];
        for row in &self.0 {
            for relation in &row.features {
                let kind = relation.kind();
                let named = |component: &usize| RelationFeature {
                    name: format!("{}.{}.{}", row.name, relation.words()[*component], KINDS[kind]),
                    observer: row.observer,
                };
                features[kind].extend(row.components(*relation).iter().map(named));
            }
        }
        features
    }

    /// Writes the features in their order.
    pub(super) fn write(&self, motion: &Motion<'_>, positions: &mut [f32], velocities: &mut [f32]) {
        let mut places = [positions.iter_mut(), velocities.iter_mut()];
        for row in &self.0 {
            let [of, from] = [&row.of, &row.from].map(|place| motion.of(place));
            for relation in &row.features {
                let numbers = relation.numbers(&of, &from, row.axes);
                let places = &mut places[relation.kind()];
                for (component, place) in row.components(*relation).iter().zip(places) {
                    *place = numbers[*component] as f32;
                }
            }
        }
    }
}

impl Observed {
    fn new(row: &RelationRow, robot: &Robot) -> Result<Self, SimError> {
        let from = row.from.as_deref().unwrap_or("world");
        let features = row.features.clone().unwrap_or(vec![Relation::Position, Relation::Velocity]);
        let along = row.along.clone().unwrap_or(WorldAxis::ALL.to_vec());
        let name = format!("{}/{from}", row.of);
        if features.is_empty() || along.is_empty() {
            return Err(refused(format!("state.bodies ({name}): `features` or `along` is empty")));
        }
        if row.of == from {
            return Err(refused(format!(
                "state.bodies ({name}): `of` and `from` are the same body; name another one"
            )));
        }
        let names = Names::new("body", robot.bodies());
        let observer = names.index("state.bodies.from", from)?;
        let places = [names.index("state.bodies.of", &row.of)?, observer];
        let [of, seen_from] = places.map(|body| robot.place(body));
        let axes = row.axes.unwrap_or(Axes::Body);
        if let Some(own) = features.iter().find(|own| own.is_constant([&of, &seen_from], axes)) {
            let why = if of.is_fixed() { "fixed to the world" } else { "parts of one link" };
            return Err(refused(format!(
                "state.bodies ({name}): `{}` is constant, because `{}` and `{from}` are {why}; state `features` without it, or \
                 name another body",
                own, row.of
            )));
        }
        Ok(Self {
            name,
            of,
            from: seen_from,
            features,
            along: along.into_iter().map(|axis| axis as usize).collect(),
            axes,
            observer: robot
                .tree_of_body(observer)
                .filter(|tree| robot.driven_trees().contains(tree)),
        })
    }

    /// Indices of the components of a feature.
    fn components(&self, relation: Relation) -> &[usize] {
        if relation == Relation::Orientation { &[0, 1, 2, 3] } else { &self.along }
    }
}

/// The name in task files.
impl fmt::Display for Relation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl Relation {
    /// Names of its components.
    fn words(self) -> &'static [&'static str] {
        match self {
            Self::Position | Self::Velocity => &["x", "y", "z"],
            Self::Orientation => &["qw", "qx", "qy", "qz"],
            Self::AngularVelocity => &["wx", "wy", "wz"],
        }
    }

    /// Whether it never changes between these bodies in these axes. The velocities of two bodies of a link differ if it turns.
    fn is_constant(self, [of, from]: [&Place; 2], axes: Axes) -> bool {
        let is_rigid = match self {
            Self::Position => matches!(axes, Axes::Body),
            Self::Velocity => false,
            Self::Orientation | Self::AngularVelocity => true,
        };
        of.moves_with(from) && (is_rigid || of.is_fixed())
    }

    /// Index in [`KINDS`].
    fn kind(self) -> usize {
        match self {
            Self::Position | Self::Orientation => 0,
            Self::Velocity | Self::AngularVelocity => 1,
        }
    }

    fn numbers(self, of: &PlaceMotion, from: &PlaceMotion, axes: Axes) -> [f64; 4] {
        let into = from.rotation.inverse();
        let seen = |vector: DVec3| {
            let [x, y, z] = match axes {
                Axes::World => vector.to_array(),
                Axes::Body => (into * vector).to_array(),
            };
            [x, y, z, 0.0]
        };
        match self {
            Self::Position => seen(of.position - from.position),
            Self::Velocity => seen(of.velocity - from.velocity),
            Self::AngularVelocity => seen(of.spin - from.spin),
            Self::Orientation => {
                let turn: DQuat = into * of.rotation;
                let sign = if turn.w < 0.0 { -1.0 } else { 1.0 };
                [turn.w, turn.x, turn.y, turn.z].map(|part| sign * part)
            }
        }
    }
}

impl WorldAxis {
    pub(super) const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];
}
