//! Contacts of a robot: the fixed shapes that it can touch, and the rules for all contacts.

use rapier3d::math::{Pose, Vector};

use super::super::coupling::TendonPlan;
use super::super::surface::{ContactOverride, ContactPlan, Surface};
use super::{Blueprint, JointPlan, LinkPlan, ShapePlan};
use crate::scene::Shape;

/// What enforces contacts and joint limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Law {
    /// MuJoCo's soft constraints, solved for all contacts and limits together:
    /// [`Constraints`](crate::world::Constraints).
    Constraints,
    /// The engine's solver, contact after contact, which applies this part of the contacts' compliance in units of
    /// their inverse mass; [`ContactLaw`](crate::world::ContactLaw) applies the rest from the impulses of the last
    /// step. The published robots have it.
    Engine { compliance: f32 },
}

/// A shape that is fixed to the world.
#[derive(Debug)]
pub(crate) struct GroundPlan {
    /// Its name in the model, or nothing.
    pub(crate) name: String,
    pub(crate) form: GroundForm,
    pub(crate) pose: Pose,
    pub(crate) surface: Surface,
    /// Index of its body in the model.
    pub(crate) body: usize,
}

/// Form of a shape that is fixed to the world.
#[derive(Debug)]
pub(crate) enum GroundForm {
    /// A half-space below the plane z = 0.
    Plane,
    Solid(Shape),
    /// Ground of these heights above the plane z = 0, and of its base below.
    Field(HeightField),
}

/// Heights above a rectangle around the origin.
#[derive(Debug)]
pub(crate) struct HeightField {
    /// Half the lengths along x and y, m.
    pub(crate) half_sizes: [f32; 2],
    /// Heights in a row along x.
    pub(crate) columns: usize,
    /// m, by rows; the first row has the largest y.
    pub(crate) heights: Vec<f32>,
    /// Depth of the ground below z = 0, m.
    pub(crate) base: f32,
}

impl HeightField {
    /// Number of its rows.
    pub(crate) fn rows(&self) -> usize {
        self.heights.len() / self.columns
    }

    /// The point of a row and a column, m.
    pub(crate) fn point(&self, row: usize, column: usize) -> Vector {
        let [x, y] = self.half_sizes;
        let share = |index: usize, count: usize| 2.0 * index as f32 / (count - 1) as f32 - 1.0;
        let height = self.heights[row * self.columns + column];
        Vector::new(x * share(column, self.columns), -y * share(row, self.rows()), height)
    }

    /// The box around the ground, and its pose.
    pub(crate) fn bounding_box(&self) -> (Shape, Pose) {
        let [x, y] = self.half_sizes;
        let top = self.heights.iter().copied().fold(0.0, f32::max);
        let middle = Vector::new(0.0, 0.0, 0.5 * (top - self.base));
        let half_sizes = [x, y, 0.5 * (top + self.base)];
        (Shape::Box { half_sizes }, Pose::from_translation(middle))
    }

    /// Corners of the parts of the ground, as MuJoCo divides it, that may reach into the box from `low` to `high`, m: prisms
    /// with two triangles of the surface on top of each cell.
    pub(crate) fn prisms(&self, low: Vector, high: Vector) -> impl Iterator<Item = [[f32; 3]; 6]> {
        let [x, y] = self.half_sizes;
        let cells = |from: f32, to: f32, half: f32, count: usize| {
            let last = (count - 1) as f32;
            let at = |place: f32| 0.5 * (place / half + 1.0) * last;
            let ends = [at(from).floor(), at(to).ceil()];
            let [first, end] = ends.map(|end| end.clamp(0.0, last) as usize);
            first..end
        };
        let columns = cells(low.x, high.x, x, self.columns);
        let rows = cells(-high.y, -low.y, y, self.rows()).rev();
        let prisms = rows.flat_map(move |row| {
            columns.clone().flat_map(move |column| self.prisms_of_cell(row, column))
        });
        prisms.filter(move |corners| corners.iter().any(|corner| corner[2] >= low.z))
    }

    fn prisms_of_cell(&self, row: usize, column: usize) -> [[[f32; 3]; 6]; 2] {
        let corners = [(row, column), (row + 1, column), (row, column + 1), (row + 1, column + 1)];
        let [a, b, c, d] = corners.map(|(row, column)| self.point(row, column).to_array());
        let below = |[x, y, _]: [f32; 3]| [x, y, -self.base];
        [[a, b, c], [b, c, d]].map(|[a, b, c]| [a, b, c, below(a), below(b), below(c)])
    }
}

/// Rules for contacts of a whole model.
#[derive(Clone, Debug)]
pub(crate) struct ContactRules {
    pub(crate) cone: Cone,
    /// Ratio of the compliance of a contact's normal to that of its friction.
    pub(crate) impratio: f64,
    /// What a task states in place of the model's numbers.
    pub(crate) stated: ContactOverride,
    /// Shapes that touch by rules of their own, in the order of their shapes.
    pub(crate) pairs: Vec<PairPlan>,
    /// Bodies that do not touch, the one with the smaller index first.
    pub(crate) excluded: Vec<[usize; 2]>,
    /// Whether bodies touch their parents, as without MuJoCo's flag `filterparent`.
    pub(crate) parents_touch: bool,
    /// Whether links of a robot touch each other and its base. Other shapes that can touch, such as those of different robots, always do.
    pub(crate) links_touch: bool,
}

/// Two shapes that touch by rules of their own.
#[derive(Clone, Debug)]
pub(crate) struct PairPlan {
    /// Their indices among the shapes of all links, then the fixed shapes, the smaller first.
    pub(crate) shapes: [usize; 2],
    pub(crate) contact: ContactPlan,
}

/// Limit of a contact's friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Cone {
    /// A pyramid with its edges along the tangents.
    Pyramidal,
    Elliptic,
}

impl Blueprint {
    /// Notes contacts between links of a robot and with its base as left out if they do not touch.
    pub(crate) fn note_link_contacts(&mut self) {
        let drops = |shape: &&ShapePlan| {
            let mut others = self.shapes();
            others.any(|other| self.meet(shape, other) && self.are_of_one_robot(shape, other))
        };
        let count = if self.contacts.links_touch { 0 } else { self.shapes().filter(drops).count() };
        if count > 0 {
            let what = format!("links do not touch each other: contacts between {count} shapes");
            self.left_out.push(what);
        }
    }

    /// Whether two shapes of links can touch if all links of a robot touch, by MuJoCo's rules.
    fn meet(&self, one: &ShapePlan, other: &ShapePlan) -> bool {
        let surfaces = one.surface.zip(other.surface);
        let [a, b] = [one, other].map(|shape| self.link_of_shape(shape));
        let bodies = [one.body.min(other.body), one.body.max(other.body)];
        a != b
            && surfaces.is_some_and(|(one, other)| one.meets(&other))
            && (self.contacts.parents_touch
                || (self.parent_of(a) != Some(b) && self.parent_of(b) != Some(a)))
            && !self.contacts.excluded.contains(&bodies)
    }

    /// Whether a shape of a link can touch the base of another robot, or a shape of a base a link of another robot. Callers
    /// treat the links of several trees.
    fn meets_another(&self, shape: &ShapePlan) -> bool {
        let is_base = self.links[self.link_of_shape(shape)].is_base();
        let others = self.links.iter().filter(|link| link.is_base() != is_base);
        let mut others = others.flat_map(|link| &link.shapes);
        others
            .any(|other| self.tops[shape.body] != self.tops[other.body] && self.meet(shape, other))
    }

    /// Whether a shape that moves may touch anything.
    pub(crate) fn has_contacts(&self) -> bool {
        let links_touch = self.contacts.links_touch || self.has_several_trees();
        let meets = |shape: &ShapePlan, other: &ShapePlan| {
            self.meet(shape, other)
                && (self.contacts.links_touch || !self.are_of_one_robot(shape, other))
        };
        let touches = |shape: &ShapePlan| {
            let on_ground = |ground: &GroundPlan| self.contact(shape, ground).is_some();
            self.grounds.iter().any(on_ground)
                || self.meets_another(shape)
                || (links_touch && self.shapes().any(|other| meets(shape, other)))
        };
        let mut moving = self.links.iter().filter(|link| !link.is_base());
        !self.contacts.pairs.is_empty() || moving.any(|link| link.shapes.iter().any(touches))
    }

    /// The link of the parent of a link's body; none on the world or the base. A body with several joints has links without
    /// a mass before its own.
    pub(crate) fn parent_of(&self, link: usize) -> Option<usize> {
        let mut parent = self.links[link].parent?;
        while self.links[parent].mass.inv_mass == 0.0 && !self.links[parent].is_base() {
            parent = self.links[parent].parent?;
        }
        Some(parent).filter(|parent| !self.links[*parent].is_base())
    }

    /// Has the engine's solver enforce contacts and limits, which it cannot do for all models.
    pub(crate) fn use_engine(&mut self, compliance: f32) -> Result<(), String> {
        if let Some(need) = self.unmet_requirement() {
            return Err(format!("`physics.contact_compliance` needs {need}; remove it"));
        }
        if self.contacts.cone == Cone::Elliptic {
            let what = "friction is limited by a pyramid, not by an elliptic cone";
            self.left_out.push(what.to_owned());
        }
        if self.contacts.impratio != 1.0 {
            self.left_out.push("`impratio` is 1".to_owned());
        }
        let contacts = self.shapes().filter_map(|shape| self.floor_contact(shape));
        let count = contacts.filter(|contact| contact.dimensions > 3).count();
        if count > 0 {
            let what = "contacts have no friction against spinning and rolling (`condim` 4 and 6)";
            self.left_out.push(format!("{what}; shapes: {count}"));
        }
        self.law = Law::Engine { compliance };
        Ok(())
    }

    /// Requirement of the engine's solver that the model does not meet; `None` if it meets all.
    fn unmet_requirement(&self) -> Option<&'static str> {
        if self.has_several_trees() {
            return Some("a model with one tree of bodies");
        }
        let is_plain = self.contacts.pairs.is_empty() && !self.contacts.links_touch;
        let grounds = self.grounds.as_slice();
        let is_plane = matches!(grounds, [] | [GroundPlan { form: GroundForm::Plane, .. }]);
        if !is_plain || !is_plane || self.shapes().any(|shape| self.meets_another(shape)) {
            return Some("a world with one plane and nothing else to touch");
        }
        let contacts = self.shapes().filter_map(|shape| self.floor_contact(shape));
        let contacts = contacts.map(|contact| contact.softness);
        let hinges = self.links.iter().filter_map(LinkPlan::hinge);
        let limits = hinges.filter(|hinge| hinge.range.is_some()).map(|hinge| hinge.limit);
        if !contacts.chain(limits).all(|softness| softness.is_plain()) {
            return Some(
                "`solref` with a damping ratio of 1 and `solimp` with midpoint 0.5 and power 2",
            );
        }
        let mut hinges = self.links.iter().filter_map(LinkPlan::hinge);
        let is_narrow = |[low, high]: [f32; 2], margin: f32| 2.0 * margin >= high - low;
        if hinges.any(|hinge| hinge.range.is_some_and(|range| is_narrow(range, hinge.margin))) {
            return Some("joints whose `margin` is less than half their `range`");
        }
        let free = |joint: &JointPlan| match joint {
            JointPlan::Free(free) | JointPlan::Floating(free) => free.friction,
            _ => 0.0,
        };
        let has_limit = |tendon: &TendonPlan| tendon.range.is_some() || tendon.friction > 0.0;
        if !self.equalities.is_empty()
            || !self.connections.is_empty()
            || self.tendons.iter().any(has_limit)
            || self.links.iter().any(|link| free(&link.joint) > 0.0 || link.ball().is_some())
        {
            return Some(
                "a model without equalities, ball joints, limits or friction of tendons, and friction of a free joint",
            );
        }
        if self.links.iter().filter_map(LinkPlan::hinge).any(|hinge| hinge.compensates_gravity) {
            return Some("a model without `actuatorgravcomp`");
        }
        if self.motors.iter().any(|motor| motor.thrust.is_some()) {
            return Some("a model without actuators on sites");
        }
        if self.fluid.is_some() {
            return Some("a model without the `density` and `viscosity` of a fluid");
        }
        None
    }

    /// Contact of a shape with the fixed shape `ground`; `None` if MuJoCo computes none.
    pub(crate) fn contact(&self, shape: &ShapePlan, ground: &GroundPlan) -> Option<ContactPlan> {
        let surface = shape.surface.filter(|surface| surface.meets(&ground.surface))?;
        Some(surface.contact(&ground.surface, &self.contacts.stated, self.timestep_secs))
    }

    /// Whether a shape, the one with the index `index` of all, can touch anything.
    pub(crate) fn touches(&self, link: &LinkPlan, index: usize, shape: &ShapePlan) -> bool {
        let Some(surface) = shape.surface else { return false };
        let pairs = &self.contacts.pairs;
        let links_touch =
            self.contacts.links_touch || !pairs.is_empty() || self.has_several_trees();
        let is_on_ground =
            self.grounds.iter().any(|ground| surface.meets(&ground.surface)) && !link.is_base();
        pairs.iter().any(|pair| pair.shapes.contains(&index))
            || is_on_ground
            || (links_touch && surface.collides())
            || self.meets_another(shape)
    }

    /// Contact of a shape with the first fixed shape, the only one in the engine's law.
    pub(crate) fn floor_contact(&self, shape: &ShapePlan) -> Option<ContactPlan> {
        self.contact(shape, self.grounds.first()?)
    }
}
