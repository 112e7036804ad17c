//! The terms of a reward. Each is one function of a step.

use std::collections::BTreeMap;

use rapier3d::glamx::DVec3;
use rapier3d::math::Rotation;

use super::Motion;
use super::body_terms::BodyTerm;
use super::command::{CommandRanges, Heading, PLANAR_ROOT};
use super::definition::{LARGEST_NUMBER, TermName, TermRow, check_repeats, refused, within};
use super::disturbance::ascending;
use super::healthy::{origin, reachable};
use super::names::Names;
use crate::error::{SimError, short};
use crate::robot::{JointPlan, MapKind, Place, Robot};

/// One step of an environment.
pub(crate) struct Transition<'a> {
    /// Motion before the step.
    pub(crate) before: Motion<'a>,
    /// Motion after the step.
    pub(crate) after: Motion<'a>,
    /// Controls of all agents' motors in agent order, in the motors' own units, not clamped, `[A]`.
    pub(crate) control: &'a [f32],
    /// Controls of the steps before, the newest first, at the start those of action 0, `[k, A]`; empty unless a term or a
    /// delay reads them.
    pub(crate) last_control: &'a [f32],
    /// Target velocity, m/s and rad/s, `[C]`.
    pub(crate) command: &'a [f32],
    /// The x of the mass centre of everything that moves, before and after the step, m; 0 unless a term reads it.
    pub(crate) mass_centre: [f32; 2],
    /// Duration of the step, s.
    pub(crate) dt_secs: f32,
}

/// A term with its parameters as indices of coordinates.
#[derive(Clone, Debug)]
pub(super) enum Term {
    ForwardSpeed { coordinate: usize },
    Alive,
    Control,
    TargetDistance { target: Vec<(usize, f32)> },
    Upright { tilt: Tilt },
    InRange { coordinate: usize, range: [f32; 2] },
    ActionRate,
    VelocityTracking { command: CommandRanges, components: Vec<(usize, Heading)>, sigma: f32 },
    MassCentreSpeed,
    Body(BodyTerm),
}

/// What determines the tilt of the root or another body.
#[derive(Clone, Debug)]
pub(super) enum Tilt {
    /// Index of a root's rotation about y.
    Planar(usize),
    /// Index of a root's quaternion (w x y z).
    Free(usize),
    Body(Place),
}

/// `(x' - x) / dt`: mean speed along a coordinate during the step, m/s or rad/s. Without a `coordinate`, the first one
/// of the root: its x.
pub(super) fn forward_speed(step: &Transition<'_>, coordinate: usize) -> f32 {
    (step.after.position(coordinate) - step.before.position(coordinate)) / step.dt_secs
}

/// `(x' - x) / dt` of the mass centre of everything that moves, m/s, as in MuJoCo's Humanoid.
pub(super) fn mass_centre_speed(step: &Transition<'_>) -> f32 {
    let [before, after] = step.mass_centre;
    (after - before) / step.dt_secs
}

/// 1 in every step, including the last; no unit.
pub(super) fn alive() -> f32 {
    1.0
}

/// `sum c^2` over the controls of all agents' motors before clamping, in squared units of control, as in MuJoCo's tasks.
pub(super) fn control(step: &Transition<'_>) -> f32 {
    sum_of_squares(step.control)
}

/// `sqrt(sum (q' - target)^2)` over the named coordinates: distance to the target after the step, m.
pub(super) fn target_distance(step: &Transition<'_>, target: &[(usize, f32)]) -> f32 {
    let offset = |(coordinate, target): &(usize, f32)| step.after.position(*coordinate) - target;
    target.iter().map(offset).map(|offset| offset * offset).sum::<f32>().sqrt()
}

/// Cosine of the angle between a body's z axis and the vertical after the step: 1 upright, -1 upside down; no unit.
pub(super) fn upright(motion: &Motion<'_>, tilt: &Tilt) -> f32 {
    match tilt {
        Tilt::Planar(pitch) => libm::cosf(motion.coordinates[*pitch]),
        Tilt::Free(quaternion) => {
            let [x, y] = [1, 2].map(|k| motion.position(quaternion + k));
            1.0 - 2.0 * (x * x + y * y)
        }
        Tilt::Body(place) => (motion.of(place).rotation * DVec3::Z).z as f32,
    }
}

/// 1 while a coordinate lies in its range, bounds included, else 0; no unit.
pub(super) fn in_range(step: &Transition<'_>, coordinate: usize, [low, high]: [f32; 2]) -> f32 {
    if (low..=high).contains(&step.after.position(coordinate)) { 1.0 } else { 0.0 }
}

/// `sum (c - c_last)^2` over the controls of all agents' motors before clamping, in squared units of control.
/// In the first step of an episode, `c_last` is the control of action 0.
pub(super) fn action_rate(step: &Transition<'_>) -> f32 {
    let changes = step.control.iter().zip(step.last_control);
    changes.map(|(now, last)| (now - last) * (now - last)).sum()
}

/// `exp(-sum (v - c)^2 / sigma^2)` over components of the command `c`, with the follower's velocity `v` after the step in
/// its own heading ([`CommandRanges::velocity`]): 1 at the target; no unit. `components` has indices in the command.
/// This is the tracking reward of legged-robot work, such as legged_gym's `tracking_lin_vel`, whose `tracking_sigma` is
/// `sigma^2`.
pub(super) fn velocity_tracking(
    step: &Transition<'_>,
    command: &CommandRanges,
    components: &[(usize, Heading)],
    sigma: f32,
) -> f32 {
    let error = |(index, heading): &(usize, Heading)| {
        command.velocity(*heading, &step.after) - step.command[*index]
    };
    let squares = components.iter().map(error).map(|error| error * error).sum::<f32>();
    libm::expf(-squares / (sigma * sigma))
}

fn sum_of_squares(numbers: &[f32]) -> f32 {
    numbers.iter().map(|x| x * x).sum::<f32>()
}

impl Term {
    fn value(&self, step: &Transition<'_>) -> f32 {
        match self {
            Self::ForwardSpeed { coordinate } => forward_speed(step, *coordinate),
            Self::Alive => alive(),
            Self::Control => control(step),
            Self::TargetDistance { target } => target_distance(step, target),
            Self::Upright { tilt } => upright(&step.after, tilt),
            Self::InRange { coordinate, range } => in_range(step, *coordinate, *range),
            Self::ActionRate => action_rate(step),
            Self::VelocityTracking { command, components, sigma } => {
                velocity_tracking(step, command, components, *sigma)
            }
            Self::MassCentreSpeed => mass_centre_speed(step),
            Self::Body(term) => term.value(step),
        }
    }
}

/// The terms of one list with their weights.
#[derive(Clone, Debug)]
pub(super) struct WeightedSum(Vec<(f32, Term)>);

impl WeightedSum {
    /// Resolves the rows of the list `key`.
    pub(super) fn new(
        key: &str,
        rows: &[TermRow],
        robot: &Robot,
        command: &CommandRanges,
    ) -> Result<Self, SimError> {
        let resolve = |row: &TermRow| {
            let place = format!("{key}.{}", row.term);
            within(&format!("{place}.weight"), row.weight, -LARGEST_NUMBER, LARGEST_NUMBER)?;
            Ok((row.weight, term(&place, row, robot, command)?))
        };
        rows.iter().map(resolve).collect::<Result<_, _>>().map(Self)
    }

    /// Number of terms.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// `sum weight term` in the order of the list; 0 for an empty list. Writes each `weight term` to `terms`, `[len]`.
    pub(super) fn value(&self, step: &Transition<'_>, terms: &mut [f32]) -> f32 {
        for (weighted, (weight, term)) in terms.iter_mut().zip(&self.0) {
            *weighted = weight * term.value(step);
        }
        terms.iter().copied().reduce(|sum, term| sum + term).unwrap_or(0.0)
    }

    /// The terms with a weight other than 0.
    pub(super) fn weighted(&self) -> impl Iterator<Item = &Term> {
        self.0.iter().filter(|(weight, _)| *weight != 0.0).map(|(_, term)| term)
    }

    /// Whether a term reads the actions of the step before.
    pub(super) fn reads_last_action(&self) -> bool {
        self.0.iter().any(|(_, term)| matches!(term, Term::ActionRate))
    }

    /// Whether a term reads the mass centre of everything that moves.
    pub(super) fn reads_mass_centre(&self) -> bool {
        self.0.iter().any(|(_, term)| matches!(term, Term::MassCentreSpeed))
    }
}

impl TermName {
    /// Keys of the term besides `weight`.
    fn keys(self) -> &'static [&'static str] {
        match self {
            Self::ForwardSpeed => &["coordinate"],
            Self::InRange => &["coordinate", "range"],
            Self::TargetDistance => &["target"],
            Self::VelocityTracking => &["components", "sigma", "of"],
            Self::Distance => &["of", "to", "along", "sigma"],
            Self::Approach => &["of", "to", "along"],
            Self::Progress => &["of", "along"],
            Self::Height | Self::Upright => &["of"],
            Self::Spread => &["bodies"],
            Self::Alive | Self::Control | Self::ActionRate | Self::MassCentreSpeed => &[],
        }
    }
}

/// Resolves a row's names and refuses keys that its term does not have.
fn term(
    place: &str,
    row: &TermRow,
    robot: &Robot,
    command: &CommandRanges,
) -> Result<Term, SimError> {
    let names = Names::coordinates(robot);
    let given = [
        ("coordinate", row.coordinate.is_some()),
        ("range", row.range.is_some()),
        ("target", row.target.is_some()),
        ("components", row.components.is_some()),
        ("sigma", row.sigma.is_some()),
        ("of", row.of.is_some()),
        ("to", row.to.is_some()),
        ("bodies", row.bodies.is_some()),
        ("along", row.along.is_some()),
    ];
    let unknown = given.iter().find(|(key, given)| *given && !row.term.keys().contains(key));
    if let Some((key, _)) = unknown {
        return Err(refused(format!("{place} has no key `{key}`")));
    }
    let missing = |key: &str| refused(format!("{place} needs the key `{key}`"));
    let coordinate = row.coordinate.as_ref().map(|name| names.index(place, name)).transpose()?;
    Ok(match row.term {
        TermName::ForwardSpeed => Term::ForwardSpeed {
            coordinate: coordinate.map_or_else(|| root_along_x(place, robot), Ok)?,
        },
        TermName::Alive => Term::Alive,
        TermName::Control => Term::Control,
        TermName::TargetDistance => {
            let target = row.target.as_ref().ok_or_else(|| missing("target"))?;
            Term::TargetDistance { target: resolved_target(place, target, names)? }
        }
        TermName::Upright => Term::Upright { tilt: Tilt::new(place, row.of.as_deref(), robot)? },
        TermName::InRange => {
            let coordinate = coordinate.ok_or_else(|| missing("coordinate"))?;
            let range = row.range.ok_or_else(|| missing("range"))?;
            check_range(place, range, reachable(robot, coordinate))?;
            Term::InRange { coordinate, range }
        }
        TermName::ActionRate => Term::ActionRate,
        TermName::MassCentreSpeed => Term::MassCentreSpeed,
        TermName::VelocityTracking => {
            let sigma = row.sigma.ok_or_else(|| missing("sigma"))?;
            within(&format!("{place}.sigma"), sigma, 1e-3, 1e3)?;
            let components = followed(place, row.components.as_deref(), command)?;
            let own = row.of.as_ref().map(|body| command.of(place, body, robot)).transpose()?;
            let command = own.unwrap_or_else(|| command.clone());
            Term::VelocityTracking { command, components, sigma }
        }
        TermName::Distance
        | TermName::Approach
        | TermName::Progress
        | TermName::Height
        | TermName::Spread => Term::Body(BodyTerm::new(place, row, robot)?),
    })
}

/// Refuses a range that is no range, or that a coordinate with these `bounds` never enters or never leaves.
fn check_range(place: &str, range: [f32; 2], [lowest, highest]: [f32; 2]) -> Result<(), SimError> {
    ascending(&format!("{place}.range"), range, [-LARGEST_NUMBER, LARGEST_NUMBER])?;
    let [low, high] = range;
    let (is_always, is_never) = (low <= lowest && high >= highest, high < lowest || low > highest);
    if !is_always && !is_never {
        return Ok(());
    }
    let why = origin([lowest, highest]);
    let [lowest, highest] = [lowest, highest].map(short);
    Err(refused(format!(
        "{place} is constant, because the coordinate is always in {lowest}..={highest}{why}; change its range"
    )))
}

/// The coordinate of the root along the world's x; refused if the root has none, or if another one comes first.
fn root_along_x(place: &str, robot: &Robot) -> Result<usize, SimError> {
    let link = &robot.blueprint.links[robot.layout.root];
    let is_unturned = link.rest.rotation == Rotation::IDENTITY;
    let is_along_x = match &link.joint {
        JointPlan::Hinge(hinge) => {
            let axis = &hinge.axis;
            let is_x = axis.frame == Rotation::IDENTITY && axis.free == 0 && axis.sign > 0.0;
            hinge.is_slide() && is_x && is_unturned
        }
        JointPlan::Planar(_) => is_unturned,
        JointPlan::Fixed | JointPlan::Ball(_) => false,
        JointPlan::Free(_) | JointPlan::Floating(_) => true,
    };
    if is_along_x {
        Ok(robot.layout.root_joint().coordinate)
    } else {
        Err(refused(format!(
            "{place}: the first coordinate of the root is not its x; name a `coordinate`"
        )))
    }
}

/// Components of the command that a term follows, with their indices in it: the stated ones, or else all speeds in m/s.
fn followed(
    place: &str,
    stated: Option<&[Heading]>,
    command: &CommandRanges,
) -> Result<Vec<(usize, Heading)>, SimError> {
    let speeds = command.headings().filter(|heading| *heading != Heading::Yaw);
    let followed = stated.map_or_else(|| speeds.collect(), <[Heading]>::to_vec);
    if followed.is_empty() {
        let why = "follows nothing: state a range in [command], and `components` for yaw";
        return Err(refused(format!("{place} {why}")));
    }
    check_repeats(&format!("{place}.components"), &followed)?;
    let resolve = |heading: Heading| {
        let why = || refused(format!("{place}: [command] has no range `{heading}`"));
        Ok((command.index(heading).ok_or_else(why)?, heading))
    };
    followed.into_iter().map(resolve).collect()
}

fn resolved_target(
    place: &str,
    target: &BTreeMap<String, f32>,
    names: Names<'_>,
) -> Result<Vec<(usize, f32)>, SimError> {
    if target.is_empty() {
        return Err(refused(format!("{place}.target names no coordinate")));
    }
    let resolve = |(name, value): (&String, &f32)| {
        within(&format!("{place}.target.{name}"), *value, -LARGEST_NUMBER, LARGEST_NUMBER)?;
        Ok((names.index(&format!("{place}.target"), name)?, *value))
    };
    target.iter().map(resolve).collect()
}

impl Tilt {
    /// The tilt of the body that the key `of` at `place` names, or of the robot's root.
    pub(super) fn new(place: &str, of: Option<&str>, robot: &Robot) -> Result<Self, SimError> {
        if let Some(name) = of {
            let body = Names::body(robot, &format!("{place}.of"), name)?;
            if body.is_fixed() {
                let why = "its body is fixed to the world; name one that moves";
                return Err(refused(format!("{place} is constant, because {why}")));
            }
            return Ok(Self::Body(body));
        }
        let root = robot.layout.root_joint();
        match root.kind {
            MapKind::Free | MapKind::Floating => Ok(Self::Free(root.coordinate + 3)),
            MapKind::Planar => Ok(match robot.tilted_root() {
                None => Self::Planar(root.coordinate + 2),
                Some(body) => Self::Body(body),
            }),
            MapKind::Fixed | MapKind::Hinge { .. } | MapKind::Ball => Err(refused(format!(
                "{place} needs a free root or a {PLANAR_ROOT}; name a body with `of`"
            ))),
        }
    }
}
