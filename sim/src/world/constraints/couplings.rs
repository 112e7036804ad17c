//! Constraints of tendons and equalities: limits and dry friction of tendons, and equalities of joints and tendons.

use super::Rule;
use super::motion::Motion;
use super::problem::{ConstraintProblem, Kind};
use crate::robot::{Combination, ConnectionPlan, Coupled, EqualityPlan, Layout, Robot, TendonPlan};

/// Adds all constraints of a robot's tendons and equalities.
pub(super) fn add(problem: &mut ConstraintProblem, start: &Motion, robot: &Robot, rule: Rule) {
    let (blueprint, layout) = (robot.blueprint(), robot.layout());
    for equality in &blueprint.equalities {
        add_equality(problem, start, (equality, robot), rule);
    }
    for (connection, inverse) in blueprint.connections.iter().zip(&layout.connection_inverses) {
        add_connection(problem, start, (connection, *inverse), rule);
    }
    for (tendon, inverse) in blueprint.tendons.iter().zip(&layout.tendon_inverses) {
        add_limit(problem, start, (tendon, layout, *inverse), rule);
        add_friction(problem, start, (tendon, layout, *inverse), rule);
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
    rule: Rule,
) {
    let layout = robot.layout();
    let side = |coupled: Coupled| match coupled {
        Coupled::Hinge(hinge) => {
            (Combination::of_hinge(hinge), f64::from(layout.hinges[hinge].inverse_inertia))
        }
        Coupled::Tendon(tendon) => {
            (robot.blueprint().tendons[tendon].moved.clone(), layout.tendon_inverses[tendon])
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
    let aim = rule.aim(&equality.softness, Some(-off.abs()), speed);
    problem.set_row(aim, f64::from(equality.softness.compliance(off.abs() as f32)) * inverse);
    problem.close(Kind::Hold);
}

fn add_connection(
    problem: &mut ConstraintProblem,
    start: &Motion,
    (connection, inverse): (&ConnectionPlan, f64),
    rule: Rule,
) {
    let links = connection.ends.map(|end| end.link.map(|link| &start.links[link]));
    let [first, second] = [0, 1].map(|k| {
        let point = connection.ends[k].point;
        links[k].map_or(point, |link| link.pose * point)
    });
    let off = (first - second).to_array().map(f64::from);
    let violation = off.iter().map(|part| part * part).sum::<f64>().sqrt();
    let compliance = f64::from(connection.softness.compliance(violation as f32)) * inverse;
    for (axis, part) in off.into_iter().enumerate() {
        let (row, mut speed) = (problem.add_row(), 0.0);
        for (sign, link, point) in [(1.0, links[0], first), (-1.0, links[1], second)] {
            let Some(link) = link else { continue };
            let point = point.to_array().map(f64::from);
            let centre = link.mass_centre.to_array();
            let arm: [f64; 3] = std::array::from_fn(|k| point[k] - centre[k]);
            for (dof, column) in link.jacobian.iter().enumerate() {
                let [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
                let turned = column[3 + b] * arm[c] - column[3 + c] * arm[b];
                let moved = sign * (column[axis] + turned);
                row[dof] += moved;
                speed += moved * start.speeds[dof];
            }
        }
        let softness = &connection.softness;
        let aim =
            softness.acceleration_at(violation, rule.integration, rule.step_secs, [part, speed]);
        problem.set_row(aim, compliance);
        problem.close(Kind::Hold);
    }
}

fn add_limit(
    problem: &mut ConstraintProblem,
    start: &Motion,
    (tendon, layout, inverse): (&TendonPlan, &Layout, f64),
    rule: Rule,
) {
    let Some(range) = tendon.range else { return };
    let [low, high] = range.map(f64::from);
    let (at, margin) = (length(start, &tendon.moved), f64::from(tendon.margin));
    for (inward, distance) in [(1.0, at - low - margin), (-1.0, high - at - margin)] {
        if distance < 0.0 {
            let speed = fill(problem.add_row(), start, layout, (&tendon.moved, inward));
            let compliance = f64::from(tendon.limit.compliance(-distance as f32));
            problem.set_row(rule.aim(&tendon.limit, Some(distance), speed), compliance * inverse);
            problem.close(Kind::Push);
        }
    }
}

fn add_friction(
    problem: &mut ConstraintProblem,
    start: &Motion,
    (tendon, layout, inverse): (&TendonPlan, &Layout, f64),
    rule: Rule,
) {
    if tendon.friction > 0.0 {
        let softness = &tendon.friction_softness;
        let speed = fill(problem.add_row(), start, layout, (&tendon.moved, 1.0));
        let compliance = f64::from(softness.compliance(0.0));
        problem.set_row(rule.aim(softness, None, speed), compliance * inverse);
        problem.close(Kind::Bounded(f64::from(tendon.friction)));
    }
}
