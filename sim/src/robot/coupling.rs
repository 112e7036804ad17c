//! Tendons and equality constraints: sums of the positions of several hinges that springs, limits, actuators and
//! constraints act on; and sites that actuators push.

use std::sync::Arc;

use rapier3d::glamx::DVec3;
use rapier3d::math::{Rotation, Vector};

use super::softness::Softness;

/// A weighted sum of the positions of hinges, as their indices among all hinges and their coefficients. All actuators and
/// worlds share the terms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Combination(pub(crate) Arc<[(usize, f32)]>);

/// Force and torque at a site of a link for each unit that [`MotorPlan::gear`](super::blueprint::MotorPlan::gear) gives, in the
/// axes of the link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Thrust {
    pub(crate) link: usize,
    /// The site in the link, m.
    pub(crate) point: Vector,
    pub(crate) force: DVec3,
    pub(crate) torque: DVec3,
}

/// MuJoCo's `fixed` tendon. Its length is 0 in the rest pose; lengths are in m or rad, forces in N or N m.
#[derive(Clone, Debug)]
pub(crate) struct TendonPlan {
    pub(crate) name: String,
    pub(crate) moved: Combination,
    /// Difference of MuJoCo's length from this crate's.
    pub(crate) reference: f32,
    pub(crate) range: Option<[f32; 2]>,
    /// Distance from the range's ends at which they push.
    pub(crate) margin: f32,
    pub(crate) limit: Softness,
    pub(crate) stiffness: f32,
    /// Lengths between which its spring is slack.
    pub(crate) slack: [f32; 2],
    pub(crate) damping: f32,
    /// Largest dry friction.
    pub(crate) friction: f32,
    pub(crate) friction_softness: Softness,
}

/// MuJoCo's equality of two joints or tendons, `first = polynomial(second)`, each relative to the rest pose.
#[derive(Clone, Debug)]
pub(crate) struct EqualityPlan {
    pub(crate) first: Coupled,
    /// Without it, `first` is the polynomial's constant.
    pub(crate) second: Option<Coupled>,
    /// Coefficients of the powers 0 to 4.
    pub(crate) polynomial: [f64; 5],
    pub(crate) softness: Softness,
}

/// MuJoCo's equalities `connect` and `weld`: two points of links, or of a link and the world, that are at the same place,
/// also in the same rotation if they are welded.
#[derive(Clone, Debug)]
pub(crate) struct ConnectionPlan {
    pub(crate) ends: [ConnectedFrame; 2],
    /// Factor of the rotations' residuals, m, if the ends are welded.
    pub(crate) torque_scale: Option<f64>,
    pub(crate) softness: Softness,
}

/// An end of a connection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ConnectedFrame {
    /// Index of the link; `None` for the world.
    pub(crate) link: Option<usize>,
    /// In the link's frame, m.
    pub(crate) point: Vector,
    /// In the link's frame; equal at both ends of a weld that holds.
    pub(crate) rotation: Rotation,
    /// Mass centre of the body that the model connects, in the link's frame, m.
    pub(crate) mass_centre: Vector,
}

/// A side of an equality.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Coupled {
    /// Index among all hinges.
    Hinge(usize),
    /// Index among all tendons.
    Tendon(usize),
}

impl Combination {
    /// The hinge alone.
    pub(crate) fn of_hinge(hinge: usize) -> Self {
        Self(Arc::new([(hinge, 1.0)]))
    }

    /// The sum, given the numbers of all hinges.
    pub(crate) fn sum(&self, number: impl Fn(usize) -> f32) -> f32 {
        self.0.iter().fold(0.0, |sum, (hinge, factor)| sum + factor * number(*hinge))
    }

    /// The hinge, if it is the only one and its coefficient is 1.
    pub(crate) fn only_hinge(&self) -> Option<usize> {
        match &*self.0 {
            [(hinge, factor)] if *factor == 1.0 => Some(*hinge),
            _ => None,
        }
    }
}

impl TendonPlan {
    /// Force of its spring and damper.
    pub(crate) fn passive_force(&self, length: f32, speed: f32) -> f32 {
        -self.stiffness * self.stretch(length) - self.damping * speed
    }

    /// How much longer than without force its spring is; negative if it is shorter.
    pub(crate) fn stretch(&self, length: f32) -> f32 {
        let [low, high] = self.slack;
        if length > high { length - high } else { (length - low).min(0.0) }
    }
}

impl EqualityPlan {
    /// The polynomial and its derivative.
    pub(crate) fn polynomial(&self, at: f64) -> [f64; 2] {
        let powers = self.polynomial.iter().rev();
        powers.fold([0.0; 2], |[value, slope], factor| [value * at + factor, slope * at + value])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_has_its_value_and_slope() {
        let softness = Softness::new([0.02, 1.0], Softness::DEFAULT.1, 0.002);
        let polynomial = [1.0, -2.0, 0.5, 0.25, -1.0];
        let equality =
            EqualityPlan { first: Coupled::Hinge(0), second: None, polynomial, softness };
        // 1 - 4 + 2 + 2 - 16, and -2 + 2 + 3 - 32.
        assert_eq!(equality.polynomial(2.0), [-15.0, -29.0]);
    }
}
