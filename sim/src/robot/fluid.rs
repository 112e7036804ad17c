//! MuJoCo's forces of a fluid on bodies, each of which counts as the box with its mass and inertia.

use rapier3d::math::{Pose, Rotation, Vector};

use super::inertia::Solid;

/// A fluid that fills the world.
#[derive(Clone, Debug)]
pub(crate) struct Fluid {
    /// kg/m^3.
    pub(crate) density: f64,
    /// Pa s.
    pub(crate) viscosity: f64,
    /// Velocity of the fluid, m/s.
    pub(crate) wind: [f64; 3],
    /// The bodies that it acts on.
    pub(crate) boxes: Vec<FluidBox>,
}

/// A body as a box.
#[derive(Clone, Debug)]
pub(crate) struct FluidBox {
    pub(crate) link: usize,
    /// Pose in the link.
    pub(crate) pose: Pose,
    /// Lengths of the edges, m.
    pub(crate) sizes: [f64; 3],
}

impl Fluid {
    /// Whether it exerts forces.
    pub(crate) fn acts(&self) -> bool {
        self.density > 0.0 || self.viscosity > 0.0
    }

    /// Adds a body in a link, as a box along `axes`, along which it has its principal moments.
    pub(super) fn add(&mut self, link: usize, solid: &Solid, axes: Rotation) {
        let [x, y, z] = solid.moments_along(axes);
        let edge = |square: f64| (6.0 * square.max(1e-15) / solid.mass).sqrt();
        let sizes = [edge(y + z - x), edge(x + z - y), edge(x + y - z)];
        let centre = Vector::from_array(solid.centre.map(|number| number as f32));
        self.boxes.push(FluidBox { link, pose: Pose::from_parts(centre, axes), sizes });
    }

    /// Force, N, and torque, N m, on a box with these velocities relative to the fluid, m/s and rad/s, all in its axes.
    pub(crate) fn wrench(
        &self,
        [x, y, z]: [f64; 3],
        [velocity, spin]: [[f64; 3]; 2],
    ) -> [[f64; 3]; 2] {
        let length = (x + y + z) / 3.0;
        let slow = 3.0 * std::f64::consts::PI * length * self.viscosity;
        let sides = [y * z, x * z, x * y];
        let arms = [[y, z, x], [x, z, y], [x, y, z]].map(|[a, b, along]| {
            let [a, b] = [a * a, b * b];
            along * (a * a + b * b)
        });
        let fast = |area: f64, speed: f64| area * self.density * speed.abs() * speed;
        [
            std::array::from_fn(|k| -slow * velocity[k] - fast(0.5 * sides[k], velocity[k])),
            std::array::from_fn(|k| {
                -slow * length * length / 3.0 * spin[k] - fast(arms[k] / 64.0, spin[k])
            }),
        ]
    }
}
