//! Constraints of tendons and equalities: limits and dry friction of tendons, and equalities of joints and tendons.

use rapier3d::glamx::DVec3;

use super::matrix::dot;
use super::motion::{LinkMotion, Motion};
use super::problem::{ConstraintProblem, Kind};
use crate::robot::{
    Combination, ConnectionPlan, Coupled, EqualityPlan, Layout, Robot, TendonPlan, product,
};

/// Adds all constraints of a robot's tendons and equalities.
pub(super) fn add(problem: &mut ConstraintProblem, start: &Motion, robot: &Robot) {
    let (blueprint, layout) = (&robot.blueprint, &robot.layout);
    for equality in &blueprint.equalities {
        add_equality(problem, start, (equality, robot));
    }
    for (connection, inverse) in blueprint.connections.iter().zip(&layout.connection_inverses) {
        add_connection(problem, start, (connection, *inverse));
    }
    for (tendon, inverse) in blueprint.tendons.iter().zip(&layout.tendon_inverses) {
        add_limit(problem, start, (tendon, layout, *inverse));
        add_friction(problem, start, (tendon, layout, *inverse));
    }
}

/// Adds a multiple of a combination to the row that was added last. Returns its speed.
fn fill(
    row: &mut [f64],
    start: &Motion,
    layout: &Layout,
    (moved, factor): (&Combination, f64),
) -> f64 {
    let terms = moved.0.iter().map(|(hinge, part)| {
        let hinge = &layout.hinges[*hinge];
        let part = factor * f64::from(part * hinge.plan.axis.sign);
        row[hinge.dof] += part;
        part * start.speeds[hinge.dof]
    });
    terms.fold(0.0, |sum, term| sum + term)
}

fn length(start: &Motion, moved: &Combination) -> f64 {
    moved.0.iter().fold(0.0, |sum, (hinge, part)| sum + f64::from(*part) * start.hinges[*hinge])
}

fn add_equality(
    problem: &mut ConstraintProblem,
    start: &Motion,
    (equality, robot): (&EqualityPlan, &Robot),
) {
    let layout = &robot.layout;
    let side = |coupled: Coupled| match coupled {
        Coupled::Hinge(hinge) => {
            (Combination::of_hinge(hinge), f64::from(layout.hinges[hinge].inverse_inertia))
        }
        Coupled::Tendon(tendon) => {
            (robot.blueprint.tendons[tendon].moved.clone(), layout.tendon_inverses[tendon])
        }
    };
    let (first, mut inverse) = side(equality.first);
    let second = equality.second.map(side);
    let at = second.as_ref().map_or(0.0, |(moved, _)| length(start, moved));
    let [value, slope] = equality.polynomial(at);
    let off = length(start, &first) - value;
    // Both directions are violations; the row points out of this one.
    let inward = if off > 0.0 { -1.0 } else { 1.0 };
    let row = problem.add_row();
    let mut speed = fill(row, start, layout, (&first, inward));
    if let Some((moved, other)) = &second {
        speed += fill(row, start, layout, (moved, -inward * slope));
        inverse += other;
    }
    let aim = equality.softness.reference_acceleration(Some(-off.abs()), speed);
    problem.set_row(aim, f64::from(equality.softness.compliance(off.abs() as f32)) * inverse);
    problem.close(Kind::Hold);
}

/// A row of a connection.
struct Held {
    /// Its violation, m.
    off: f64,
    /// Force and torque of unit size with which it holds its ends.
    wrench: [DVec3; 2],
    /// Rate of its speed while all velocities of the joints are constant, m/s^2.
    drift: f64,
    /// Inverse mass, 1/kg, or inertia, 1/(kg m^2).
    inverse: f64,
}

fn add_connection(
    problem: &mut ConstraintProblem,
    start: &Motion,
    (connection, [inverse, turning_inverse]): (&ConnectionPlan, [f64; 2]),
) {
    let links = connection.ends.map(|end| end.link.map(|link| &start.links[link]));
    let [first, second] = [0, 1].map(|k| {
        let point = connection.ends[k].point;
        links[k].map_or(point, |link| link.pose * point)
    });
    let off = (first - second).as_dvec3().to_array();
    let [one, other] = [(links[0], first), (links[1], second)]
        .map(|(link, point)| link.map_or(DVec3::ZERO, |link| link.acceleration(point.as_dvec3())));
    let drift = (one - other).to_array();
    let along = |axis: usize| [DVec3::AXES[axis], DVec3::ZERO];
    let held = |k: usize| Held { off: off[k], wrench: along(k), drift: drift[k], inverse };
    let mut rows: Vec<Held> = (0..3).map(held).collect();
    if let Some(scale) = connection.torque_scale {
        rows.extend(weld_rows(connection, links, scale, turning_inverse));
    }
    let violation = rows.iter().map(|row| row.off * row.off).sum::<f64>().sqrt();
    let softness = &connection.softness;
    let compliance = f64::from(softness.compliance(violation as f32));
    for Held { off, wrench, drift, inverse } in rows {
        let row = problem.add_row();
        for (sign, link, point) in [(1.0, links[0], first), (-1.0, links[1], second)] {
            if let Some(link) = link {
                start.add_levers(row, (link, point.as_dvec3()), wrench, sign);
            }
        }
        let speed = dot(row, &start.speeds);
        let aim = softness.acceleration_at(violation, [off, speed]);
        problem.set_row(aim - drift, compliance * inverse);
        problem.close(Kind::Hold);
    }
}

/// Rows of a weld: with the rotations `q` and `p` of its ends, the vector of the quaternion `scale p* q`.
fn weld_rows(
    connection: &ConnectionPlan,
    links: [Option<&LinkMotion>; 2],
    scale: f64,
    inverse: f64,
) -> [Held; 3] {
    let [first, [x, y, z, w]] = [0, 1].map(|k| {
        let own = connection.ends[k].rotation;
        links[k].map_or(own, |link| link.pose.rotation * own).to_array().map(f64::from)
    });
    let [[spin, turning], [other_spin, other_turning]] =
        links.map(|link| link.map_or([DVec3::ZERO; 2], |link| [link.velocity[1], link.rates[1]]));
    let (back, relative) = ([-x, -y, -z, w], spin - other_spin);
    let pure = |vector: DVec3| [vector.x, vector.y, vector.z, 0.0];
    let between = |middle: [f64; 4]| product(product(back, middle), first);
    let off = product(back, first);
    let slopes = DVec3::AXES.map(|axis| between(pure(axis)));
    let rate = pure(turning - other_turning);
    let after = product(pure(relative), pure(spin));
    let before = product(pure(other_spin), pure(relative));
    let drift = between(std::array::from_fn(|k| rate[k] + 0.5 * (after[k] - before[k])));
    [0, 1, 2].map(|part| {
        let torque = 0.5 * scale * DVec3::from_array(slopes.map(|slope| slope[part]));
        let wrench = [DVec3::ZERO, torque];
        Held { off: scale * off[part], wrench, drift: 0.5 * scale * drift[part], inverse }
    })
}

fn add_limit(
    problem: &mut ConstraintProblem,
    start: &Motion,
    (tendon, layout, inverse): (&TendonPlan, &Layout, f64),
) {
    let Some(range) = tendon.range else { return };
    let [low, high] = range.map(f64::from);
    let (at, margin) = (length(start, &tendon.moved), f64::from(tendon.margin));
    for (inward, distance) in [(1.0, at - low - margin), (-1.0, high - at - margin)] {
        if distance < 0.0 {
            let speed = fill(problem.add_row(), start, layout, (&tendon.moved, inward));
            let compliance = f64::from(tendon.limit.compliance(-distance as f32));
            problem.set_row(
                tendon.limit.reference_acceleration(Some(distance), speed),
                compliance * inverse,
            );
            problem.close(Kind::Push);
        }
    }
}

fn add_friction(
    problem: &mut ConstraintProblem,
    start: &Motion,
    (tendon, layout, inverse): (&TendonPlan, &Layout, f64),
) {
    if tendon.friction > 0.0 {
        let softness = &tendon.friction_softness;
        let speed = fill(problem.add_row(), start, layout, (&tendon.moved, 1.0));
        let compliance = f64::from(softness.compliance(0.0));
        problem.set_row(softness.reference_acceleration(None, speed), compliance * inverse);
        problem.close(Kind::Bounded(f64::from(tendon.friction)));
    }
}
