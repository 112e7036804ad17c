//! Terms of a reward about bodies: objects, targets, and robots of a team.

use std::slice;

use rapier3d::glamx::DVec3;
use serde::Deserialize;

use super::Motion;
use super::definition::{TermName, TermRow, check_repeats, refused, within};
use super::names::Names;
use super::relations::WorldAxis;
use super::terms::Transition;
use crate::error::SimError;
use crate::robot::{Place, Robot};

/// What a term measures to: a body by its name, or a point in the world, m.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "`to` must be the name of a body or a point [x, y, z]")]
pub(crate) enum Goal {
    /// Name of a body.
    Body(String),
    /// Fixed point.
    Point([f32; 3]),
}

/// A term about bodies, with its names resolved.
#[derive(Clone, Debug)]
pub(super) enum BodyTerm {
    /// [`distance`]; with `sigma` [`closeness`].
    Distance { between: [Place; 2], along: Vec<WorldAxis>, sigma: Option<f32> },
    /// [`approach`]
    Approach { between: [Place; 2], along: Vec<WorldAxis> },
    /// [`progress`]
    Progress { of: Place, axis: WorldAxis },
    /// [`height`]
    Height { of: Place },
    /// [`spread`]
    Spread { bodies: Vec<Place> },
}

/// `sqrt(sum (a - b)^2)` over the axes `along`: distance of two bodies' origins after the step, m.
pub(super) fn distance(motion: &Motion<'_>, [a, b]: [&Place; 2], along: &[WorldAxis]) -> f32 {
    length(motion.of(a).position - motion.of(b).position, along)
}

/// `sqrt(sum v^2)` over the axes `along`, m.
fn length(offset: DVec3, along: &[WorldAxis]) -> f32 {
    let squares = along.iter().map(|axis| offset[*axis as usize] * offset[*axis as usize]);
    squares.sum::<f64>().sqrt() as f32
}

/// `exp(-d^2 / sigma^2)` of the distance `d`: 1 at the target; no unit.
pub(super) fn closeness(distance: f32, sigma: f32) -> f32 {
    libm::expf(-distance * distance / (sigma * sigma))
}

/// `(d - d') / dt` of the distance `d`: mean speed at which two bodies approach during the step, m/s. Its sum over an episode
/// times `dt` is how much closer they are at the end.
pub(super) fn approach(step: &Transition<'_>, between: [&Place; 2], along: &[WorldAxis]) -> f32 {
    let [before, after] = [step.before, step.after].map(|motion| distance(&motion, between, along));
    (before - after) / step.dt_secs
}

/// `(x' - x) / dt`: mean speed of a body's origin along an axis of the world during the step, m/s.
pub(super) fn progress(step: &Transition<'_>, of: &Place, axis: WorldAxis) -> f32 {
    let [before, after] =
        [step.before, step.after].map(|motion| motion.of(of).position[axis as usize]);
    (after - before) as f32 / step.dt_secs
}

/// `z` of a body's origin in the world after the step, m.
pub(super) fn height(motion: &Motion<'_>, of: &Place) -> f32 {
    motion.of(of).position.z as f32
}

/// `sum_{i<j} |p_i - p_j| / (n (n - 1) / 2)`: mean distance of the origins of `n` bodies after the step, m.
pub(super) fn spread(motion: &Motion<'_>, bodies: &[Place]) -> f32 {
    let positions: Vec<DVec3> = bodies.iter().map(|body| motion.of(body).position).collect();
    let pairs = positions.iter().enumerate().flat_map(|(index, one)| {
        positions[..index].iter().map(move |other| length(*one - *other, &WorldAxis::ALL))
    });
    let count = bodies.len() * (bodies.len() - 1) / 2;
    pairs.sum::<f32>() / count as f32
}

impl BodyTerm {
    pub(super) fn value(&self, step: &Transition<'_>) -> f32 {
        match self {
            Self::Distance { between, along, sigma } => {
                let distance = distance(&step.after, between.each_ref(), along);
                sigma.map_or(distance, |sigma| closeness(distance, sigma))
            }
            Self::Approach { between, along } => approach(step, between.each_ref(), along),
            Self::Progress { of, axis } => progress(step, of, *axis),
            Self::Height { of } => height(&step.after, of),
            Self::Spread { bodies } => spread(&step.after, bodies),
        }
    }

    /// Resolves the names of a row of a term about bodies.
    pub(super) fn new(place: &str, row: &TermRow, robot: &Robot) -> Result<Self, SimError> {
        let body = |key: &str, name: &String| Names::body(robot, &format!("{place}.{key}"), name);
        let missing = |key: &str| refused(format!("{place} needs the key `{key}`"));
        let of = || body("of", row.of.as_ref().ok_or_else(|| missing("of"))?);
        let to = || match row.to.as_ref().ok_or_else(|| missing("to"))? {
            Goal::Body(name) => body("to", name),
            Goal::Point(at) => {
                at.iter().try_for_each(|part| within(&format!("{place}.to"), *part, -1e5, 1e5))?;
                Ok(Place::point(*at))
            }
        };
        let between = || -> Result<_, SimError> {
            match (&row.of, &row.to) {
                (Some(of), Some(Goal::Body(to))) if of == to => Err(refused(format!(
                    "{place} measures from `{of}` to itself; name another body or a point in `to`"
                ))),
                _ => Ok([of()?, to()?]),
            }
        };
        let along = row.along.clone().unwrap_or(WorldAxis::ALL.to_vec());
        if along.is_empty() {
            return Err(refused(format!("{place}.along names no axis")));
        }
        check_repeats(&format!("{place}.along"), &along)?;
        let term = match row.term {
            TermName::Approach => Self::Approach { between: between()?, along },
            TermName::Progress => match row.along.as_deref() {
                None => Self::Progress { of: of()?, axis: WorldAxis::X },
                Some([axis]) => Self::Progress { of: of()?, axis: *axis },
                Some(_) => return Err(refused(format!("{place}.along must name one axis"))),
            },
            TermName::Height => Self::Height { of: of()? },
            TermName::Spread => {
                let bodies = row.bodies.as_ref().ok_or_else(|| missing("bodies"))?;
                check_repeats(&format!("{place}.bodies"), bodies)?;
                if bodies.len() < 2 {
                    return Err(refused(format!("{place}.bodies must name at least two bodies")));
                }
                let bodies = bodies.iter().map(|name| body("bodies", name));
                Self::Spread { bodies: bodies.collect::<Result<_, _>>()? }
            }
            _ => {
                let sigma = row.sigma;
                sigma
                    .map_or(Ok(()), |sigma| within(&format!("{place}.sigma"), sigma, 1e-3, 1e3))?;
                Self::Distance { between: between()?, along, sigma }
            }
        };
        match term.reason_for_constancy() {
            None => Ok(term),
            Some(reason) => Err(refused(format!("{place} is constant, because {reason}"))),
        }
    }

    /// Why its value is constant, and what to do; `None` if it can change.
    fn reason_for_constancy(&self) -> Option<&'static str> {
        if self.places().iter().all(Place::is_fixed) {
            return Some("all its bodies are fixed to the world; name one that moves");
        }
        let is_rigid = match self {
            // A turn changes a distance along some axes only.
            Self::Distance { between: [of, to], along, .. }
            | Self::Approach { between: [of, to], along } => {
                of.moves_with(to) && along.len() == WorldAxis::ALL.len()
            }
            Self::Spread { bodies } => bodies.iter().all(|body| body.moves_with(&bodies[0])),
            Self::Progress { .. } | Self::Height { .. } => false,
        };
        is_rigid.then_some("its bodies are parts of one link; name one of another link")
    }

    /// What it measures.
    fn places(&self) -> &[Place] {
        match self {
            Self::Distance { between, .. } | Self::Approach { between, .. } => between,
            Self::Progress { of, .. } | Self::Height { of } => slice::from_ref(of),
            Self::Spread { bodies } => bodies,
        }
    }
}
