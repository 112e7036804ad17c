//! Contact properties of shapes, and how MuJoCo combines those of two shapes.

use super::document::Element;
use super::softness::{Softness, SoftnessOverride};

/// Smallest friction coefficient of a contact with friction, as in MuJoCo.
const LEAST_FRICTION: f64 = 1e-5;

/// Contact properties that a shape states.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    contype: i64,
    conaffinity: i64,
    priority: i64,
    /// Number of constrained directions of a contact: 1, 3, 4 or 6.
    dimensions: i64,
    /// Sliding, torsional and rolling friction; the last two in m.
    friction: [f64; 3],
    /// Distance at which contacts become active, m. MuJoCo's `gap` beyond it has no effect on the motion.
    margin: f64,
    mix: f64,
    solref: [f64; 2],
    solimp: [f64; 5],
}

/// A contact of two shapes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ContactPlan {
    /// Number of constrained directions: 1, 3, 4 or 6.
    pub(crate) dimensions: usize,
    /// Friction along the two tangents, about the normal and about the two tangents; the last three in m.
    pub(crate) friction: [f64; 5],
    /// Distance at which the contact becomes active, m.
    pub(crate) margin: f32,
    pub(crate) softness: Softness,
    /// Softness of the friction of an elliptic cone, if it has its own; only the damping counts.
    pub(crate) friction_softness: Option<Softness>,
}

/// What a task states in place of the model's contact properties.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ContactOverride {
    pub(crate) softness: SoftnessOverride,
    pub(crate) margin: Option<f32>,
}

impl ContactPlan {
    /// The contact with all friction coefficients times `factor`.
    pub(crate) fn with_friction(self, factor: f64) -> Self {
        Self { friction: self.friction.map(|mu| (mu * factor).max(LEAST_FRICTION)), ..self }
    }

    /// Friction coefficient against sliding; 0 without friction.
    pub(crate) fn sliding_friction(&self) -> f64 {
        if self.dimensions == 1 { 0.0 } else { self.friction[0] }
    }
}

impl Surface {
    /// Attributes of a shape that [`Self::read`] reads.
    pub(super) const ATTRIBUTES: [&str; 9] = [
        "contype",
        "conaffinity",
        "priority",
        "condim",
        "friction",
        "margin",
        "solmix",
        "solref",
        "solimp",
    ];

    pub(super) fn read(element: &Element) -> Result<Self, String> {
        let (solref, solimp) = Softness::DEFAULT;
        let surface = Self {
            contype: element.integer("contype", 1)?,
            conaffinity: element.integer("conaffinity", 1)?,
            priority: element.integer("priority", 0)?,
            dimensions: element.integer("condim", 3)?,
            friction: element.padded("friction", [1.0, 0.005, 0.0001])?,
            margin: element.number("margin", 0.0)?,
            mix: element.number("solmix", 1.0)?,
            solref: element.padded("solref", solref)?,
            solimp: element.padded("solimp", solimp)?,
        };
        if ![1, 3, 4, 6].contains(&surface.dimensions) {
            return Err(element.refuse_for("condim", "`condim` must be 1, 3, 4 or 6"));
        }
        Softness::check("solref", surface.solref)
            .map_err(|reason| element.refuse_for("solref", reason))?;
        Ok(surface)
    }

    /// Whether the shape can touch anything.
    pub(crate) fn collides(&self) -> bool {
        self.contype != 0 || self.conaffinity != 0
    }

    /// Whether MuJoCo computes contacts between two shapes.
    pub(crate) fn meets(&self, other: &Self) -> bool {
        self.contype & other.conaffinity != 0 || other.contype & self.conaffinity != 0
    }

    /// Distance at which the engine has to find contacts of the shape, m.
    pub(crate) fn reach(&self, stated: &ContactOverride) -> f32 {
        stated.margin.unwrap_or(self.margin as f32)
    }

    /// A contact with another shape, by MuJoCo's rules, in a model with steps of `step_secs`.
    pub(crate) fn contact(
        &self,
        other: &Self,
        stated: &ContactOverride,
        step_secs: f64,
    ) -> ContactPlan {
        let margin = self.margin + other.margin;
        let chosen = self.combined(other);
        let softness = Softness::new(chosen.solref, chosen.solimp, step_secs);
        let [slide, twist, roll] = chosen.friction.map(|mu| mu.max(LEAST_FRICTION));
        ContactPlan {
            dimensions: chosen.dimensions as usize,
            friction: [slide, slide, twist, roll, roll],
            margin: stated.margin.unwrap_or(margin as f32),
            softness: softness.with(&stated.softness, step_secs),
            friction_softness: None,
        }
    }

    fn combined(&self, other: &Self) -> Self {
        if self.priority != other.priority {
            return if self.priority > other.priority { *self } else { *other };
        }
        let share =
            if self.mix + other.mix > 0.0 { self.mix / (self.mix + other.mix) } else { 0.5 };
        let mean = |a: f64, b: f64| if a == b { a } else { share * a + (1.0 - share) * b };
        let timed = self.solref[0] > 0.0 && other.solref[0] > 0.0;
        let reference = |i: usize| {
            if timed {
                mean(self.solref[i], other.solref[i])
            } else {
                self.solref[i].min(other.solref[i])
            }
        };
        Self {
            friction: [0, 1, 2].map(|i| self.friction[i].max(other.friction[i])),
            dimensions: self.dimensions.max(other.dimensions),
            solref: [0, 1].map(reference),
            solimp: [0, 1, 2, 3, 4].map(|i| mean(self.solimp[i], other.solimp[i])),
            ..*self
        }
    }
}
