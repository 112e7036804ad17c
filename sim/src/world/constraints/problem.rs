//! The accelerations and forces of a robot under MuJoCo's soft constraints: a convex problem, solved by Newton's method.
//!
//! Without constraints, the accelerations `a` have `M a = b`. A constraint with the row `J` of the Jacobian, the
//! reference acceleration `a_ref` and the compliance `R` adds the force `f = (a_ref - J a) / R`, which is limited by its
//! kind. The accelerations are where `a M a / 2 - a b` plus the constraints' costs is least; a cost has the slope `-f`.

use super::matrix::{Factor, dot, multiply};
use super::rows::Rows;

/// Most steps of Newton's method; a robot on four feet needs three to six.
const MOST_STEPS: usize = 40;
/// Most lengths that are tried along a step.
const MOST_LENGTHS: usize = 24;
/// The solution is accepted when a step would lower the cost by less than this part of its scale, or when the gradient has only
/// rounding left.
const PRECISION: f64 = 1e-13;
/// A length is accepted when the slope there is less than this part of that at the start.
const FLAT: f64 = 1e-2;
/// Least compliance of a constraint, for those without inverse mass in the rest pose. MuJoCo's 1e-15 would leave too few
/// digits for the masses in the second derivatives.
const LEAST_COMPLIANCE: f64 = 1e-12;
/// Most rows of a constraint.
pub(super) const MOST_ROWS: usize = 6;

/// Limits of the forces of a constraint.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    /// One row, of which the force has no limit: an equality.
    Hold,
    /// One row, of which the force is not negative: a contact's edge, a limit.
    Push,
    /// One row, of which the force is at most this: dry friction.
    Bounded(f64),
    /// The normal of a contact, then its directions of friction with their coefficients: the forces are in MuJoCo's
    /// elliptic cone, whose opening in its regularised coordinates is `mu`.
    Cone { mu: f64, friction: [f64; MOST_ROWS - 1] },
}

/// How the cost of a constraint curves.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Zone {
    /// Not at all: the force is constant.
    Flat,
    /// Each row on its own, with `1 / R`.
    Square,
    /// All rows together: the force is on the surface of the cone.
    Surface,
}

/// A problem with its solution, and memory for the next.
#[derive(Debug, Default)]
pub(super) struct ConstraintProblem {
    /// Number of accelerations.
    size: usize,
    /// `M` by rows, of which only the lower half is read.
    pub(super) mass: Vec<f64>,
    /// `b`.
    pub(super) pull: Vec<f64>,
    /// `a`: where the search starts, then the solution.
    pub(super) accelerations: Vec<f64>,
    /// `J`, `a_ref`, and `1 / R`.
    rows: Rows,
    aims: Vec<f64>,
    weights: Vec<f64>,
    /// `f` of the solution.
    pub(super) forces: Vec<f64>,
    work: Work,
}

#[derive(Debug, Default)]
struct Work {
    /// Rows since the last constraint, in full.
    open: Vec<f64>,
    /// `J a - a_ref`, and its change per length.
    residuals: Vec<f64>,
    changes: Vec<f64>,
    tried: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
    hessian: Factor,
}

impl ConstraintProblem {
    /// Starts a problem with `size` accelerations, all of whose numbers are 0, and no constraints.
    pub(super) fn clear(&mut self, size: usize) {
        self.size = size;
        for (numbers, count) in [
            (&mut self.mass, size * size),
            (&mut self.pull, size),
            (&mut self.accelerations, size),
            (&mut self.work.gradient, size),
            (&mut self.work.step, size),
        ] {
            numbers.clear();
            numbers.resize(count, 0.0);
        }
        self.rows.clear();
        for numbers in [&mut self.aims, &mut self.weights, &mut self.forces] {
            numbers.clear();
        }
    }

    pub(super) fn has_constraints(&self) -> bool {
        !self.rows.constraints.is_empty()
    }

    /// Adds a row of a constraint, which [`Self::close`] ends, and returns it to be filled.
    pub(super) fn add_row(&mut self) -> &mut [f64] {
        let start = self.work.open.len();
        self.work.open.resize(start + self.size, 0.0);
        &mut self.work.open[start..]
    }

    /// The row that was added last.
    pub(super) fn last_row(&self) -> &[f64] {
        &self.work.open[self.work.open.len() - self.size..]
    }

    /// Sets the reference acceleration and the compliance of the row that was added last.
    pub(super) fn set_row(&mut self, aim: f64, compliance: f64) {
        self.set_scaled_row(aim, compliance, 1.0);
    }

    /// As [`Self::set_row`], with a factor of the compliance.
    pub(super) fn set_scaled_row(&mut self, aim: f64, compliance: f64, factor: f64) {
        self.aims.push(aim);
        self.weights.push(1.0 / (factor * compliance.max(LEAST_COMPLIANCE)));
    }

    /// Makes the rows since the last constraint a constraint. Returns the index of its first row.
    pub(super) fn close(&mut self, kind: Kind) -> usize {
        let first = self.forces.len();
        self.forces.resize(self.aims.len(), 0.0);
        self.rows.add(kind, first, (&self.work.open, self.size));
        self.work.open.clear();
        first
    }

    /// Finds accelerations and forces.
    pub(super) fn solve(&mut self) {
        let trace: f64 = (0..self.size).map(|k| self.mass[k * self.size + k]).sum();
        for _ in 0..MOST_STEPS {
            self.weigh();
            let energy = self.find_gradient();
            let diagonal = self.mass.iter().step_by(self.size + 1);
            let parts = self.work.gradient.iter().zip(diagonal).map(|(g, mass)| g * g / mass);
            if parts.sum::<f64>() <= PRECISION * PRECISION * (trace + energy) {
                return;
            }
            self.find_step();
            let drop = -dot(&self.work.gradient, &self.work.step);
            // Also ends the search if a number is not finite.
            if drop.is_nan() || drop <= PRECISION * (trace + energy) {
                return;
            }
            let length = self.length(-drop);
            for (number, step) in self.accelerations.iter_mut().zip(&self.work.step) {
                *number += length * step;
            }
        }
        self.weigh();
    }

    /// Forces with those of the constraints, `M a`. The sum `b + J^T f` is less exact: large forces may cancel.
    pub(super) fn total(&self, out: &mut [f64]) {
        if self.has_constraints() {
            multiply(&self.mass, &self.accelerations, out);
        } else {
            out.copy_from_slice(&self.pull);
        }
    }

    /// Computes residuals and forces at the accelerations.
    fn weigh(&mut self) {
        let work = &mut self.work;
        self.rows.multiply(&self.accelerations, &mut work.residuals);
        work.residuals.iter_mut().zip(&self.aims).for_each(|(residual, aim)| *residual -= aim);
        for constraint in &self.rows.constraints {
            let rows = constraint.first..constraint.first + constraint.count;
            let (residuals, weights) = (&work.residuals[rows.clone()], &self.weights[rows.clone()]);
            constraint.kind.force(residuals, weights, &mut self.forces[rows]);
        }
    }

    /// Computes the gradient. Returns `a M a`.
    fn find_gradient(&mut self) -> f64 {
        let Self { rows, work, .. } = self;
        multiply(&self.mass, &self.accelerations, &mut work.gradient);
        let energy = dot(&work.gradient, &self.accelerations);
        for (number, pull) in work.gradient.iter_mut().zip(&self.pull) {
            *number -= pull;
        }
        for constraint in &rows.constraints {
            let forces = &self.forces[constraint.first..constraint.first + constraint.count];
            rows.of(constraint).subtract(forces, &mut work.gradient);
        }
        energy
    }

    /// Computes Newton's step.
    fn find_step(&mut self) {
        let Self { rows, work, .. } = self;
        work.hessian.matrix.clone_from(&self.mass);
        for constraint in &rows.constraints {
            let range = constraint.first..constraint.first + constraint.count;
            let (residuals, weights) = (&work.residuals[range.clone()], &self.weights[range]);
            let mut curvature = [[0.0; MOST_ROWS]; MOST_ROWS];
            match constraint.kind.zone(residuals, weights) {
                Zone::Flat => continue,
                Zone::Square => {
                    weights.iter().enumerate().for_each(|(k, weight)| curvature[k][k] = *weight);
                }
                Zone::Surface => curvature = constraint.kind.curvature(residuals, weights),
            }
            rows.of(constraint).add_curvature(&curvature, &mut work.hessian.matrix, self.size);
        }
        work.step.copy_from_slice(&work.gradient);
        work.step.iter_mut().for_each(|number| *number = -*number);
        work.hessian.factorise(self.size);
        work.hessian.solve(&mut work.step);
    }

    /// Length of the step at which the cost is least. `slope` is that of the cost at length 0, negative.
    fn length(&mut self, slope: f64) -> f64 {
        let work = &mut self.work;
        self.rows.multiply(&work.step, &mut work.changes);
        multiply(&self.mass, &work.step, &mut work.gradient);
        let curved = dot(&work.gradient, &work.step);
        let straight = dot(&work.gradient, &self.accelerations) - dot(&work.step, &self.pull);
        let (mut low, mut high) = ((0.0, slope), None);
        let mut length = 1.0;
        for attempt in 0..MOST_LENGTHS {
            let at = straight + length * curved - self.work_of_forces(length);
            if at.abs() <= FLAT * slope.abs() {
                break;
            }
            if at < 0.0 {
                low = (length, at);
            } else {
                high = Some((length, at));
            }
            length = match high {
                None => 2.0 * length,
                Some((end, _)) if attempt % 2 == 1 => 0.5 * (low.0 + end),
                Some((end, above)) => low.0 + (end - low.0) * low.1 / (low.1 - above),
            };
        }
        length
    }

    /// Product of the forces at a length with the rows' changes per length.
    fn work_of_forces(&mut self, length: f64) -> f64 {
        let work = &mut self.work;
        work.tried.clear();
        let residuals = work.residuals.iter().zip(&work.changes);
        work.tried.extend(residuals.map(|(residual, change)| residual + length * change));
        let mut sum = 0.0;
        let mut forces = [0.0; MOST_ROWS];
        for constraint in &self.rows.constraints {
            let rows = constraint.first..constraint.first + constraint.count;
            let forces = &mut forces[..constraint.count];
            constraint.kind.force(&work.tried[rows.clone()], &self.weights[rows.clone()], forces);
            sum += dot(forces, &work.changes[rows]);
        }
        sum
    }
}

impl Kind {
    /// Forces for the residuals `J a - a_ref` and the weights `1 / R`.
    fn force(&self, residuals: &[f64], weights: &[f64], forces: &mut [f64]) {
        let square = residuals.iter().zip(weights).map(|(residual, weight)| -residual * weight);
        forces.iter_mut().zip(square).for_each(|(force, square)| *force = square);
        match self {
            Self::Hold => {}
            Self::Push => forces[0] = forces[0].max(0.0),
            Self::Bounded(most) => forces[0] = forces[0].clamp(-most, *most),
            Self::Cone { mu, friction } => {
                let (normal, slide, scaled) = scaled(*mu, friction, residuals);
                match cone_zone(*mu, normal, slide) {
                    Zone::Flat => forces.fill(0.0),
                    Zone::Square => {}
                    Zone::Surface => {
                        let depth =
                            weights[0] / (mu * mu * (1.0 + mu * mu)) * (normal - mu * slide);
                        forces[0] = -depth * mu;
                        for k in 1..forces.len() {
                            forces[k] = depth * mu * scaled[k] / slide * friction[k - 1];
                        }
                    }
                }
            }
        }
    }

    fn zone(&self, residuals: &[f64], weights: &[f64]) -> Zone {
        let is_square = match self {
            Self::Hold => true,
            Self::Push => residuals[0] < 0.0,
            Self::Bounded(most) => (residuals[0] * weights[0]).abs() < *most,
            Self::Cone { mu, friction } => {
                let (normal, slide, _) = scaled(*mu, friction, residuals);
                return cone_zone(*mu, normal, slide);
            }
        };
        if is_square { Zone::Square } else { Zone::Flat }
    }

    /// Second derivatives of the cost on the surface of a cone.
    fn curvature(&self, residuals: &[f64], weights: &[f64]) -> [[f64; MOST_ROWS]; MOST_ROWS] {
        let mut curvature = [[0.0; MOST_ROWS]; MOST_ROWS];
        let Self::Cone { mu, friction } = self else { return curvature };
        let (normal, slide, along) = scaled(*mu, friction, residuals);
        let scale = |k: usize| if k == 0 { *mu } else { friction[k - 1] };
        let depth = weights[0] / (mu * mu * (1.0 + mu * mu));
        for i in 0..residuals.len() {
            for j in 0..residuals.len() {
                let number = match (i, j) {
                    (0, 0) => 1.0,
                    (0, k) | (k, 0) => -mu * along[k] / slide,
                    _ => {
                        let across = if i == j { mu * mu - mu * normal / slide } else { 0.0 };
                        across + mu * normal * along[i] * along[j] / (slide * slide * slide)
                    }
                };
                curvature[i][j] = depth * scale(i) * scale(j) * number;
            }
        }
        curvature
    }
}

/// Where a force is for the residuals in the coordinates in which the cone is round.
fn cone_zone(mu: f64, normal: f64, slide: f64) -> Zone {
    if normal >= mu * slide {
        Zone::Flat
    } else if mu * normal + slide > 0.0 {
        Zone::Surface
    } else {
        Zone::Square
    }
}

/// Residuals in the coordinates in which the cone is round: the normal's, the length of the others, and all.
fn scaled(
    mu: f64,
    friction: &[f64; MOST_ROWS - 1],
    residuals: &[f64],
) -> (f64, f64, [f64; MOST_ROWS]) {
    let mut scaled = [0.0; MOST_ROWS];
    scaled[0] = mu * residuals[0];
    for k in 1..residuals.len() {
        scaled[k] = friction[k - 1] * residuals[k];
    }
    (scaled[0], dot(&scaled[1..], &scaled[1..]).sqrt(), scaled)
}
