//! Contacts as constraints: which shapes touch.

use rapier3d::geometry::Collider;
use rapier3d::math::{Pose, Vector};
use rapier3d::prelude::{ColliderHandle, PhysicsWorld};

use super::contact::Contact;
use super::motion::{LinkMotion, Motion};
use super::near::{Bounds, Near};
use super::points::{Manifolds, frame, is_repeated, touch, touch_field};
use super::problem::ConstraintProblem;
use crate::robot::{
    Blueprint, ContactPlan, ContactRules, GroundForm, PairPlan, Robot, Surface, shape_of,
};
use crate::scene::Shape;

/// Most contacts, and pairs of shapes that are close, in a step; each contact has up to ten rows.
const MOST_CONTACTS: usize = 2000;
const MOST_PAIRS: usize = 100_000;

/// The shapes of a robot and its world that can touch, and the contacts of the last step.
pub(super) struct Touching {
    /// The robot's shapes, then the fixed ones, as [`shape_of`] counts them.
    shapes: Vec<TouchShape>,
    near: Near,
    /// Shapes that are close in this step, in order; the first of a link and a fixed shape is the fixed one.
    pairs: Vec<[usize; 2]>,
    /// Memory for the points in which two shapes touch.
    manifolds: Manifolds,
    /// For each contact, its first row and the number of rows whose forces add up to the normal force.
    normals: Vec<(usize, usize)>,
    rules: ContactRules,
    /// For each link, that of its body's parent; none on the world or the base.
    parents: Vec<Option<usize>>,
    /// For each link, the first link of its tree.
    trees: Vec<usize>,
    /// For each body, the child of the world that it is or is in.
    tops: Vec<usize>,
    /// Factor of the model's friction.
    pub(super) friction: f64,
}

/// A shape in contacts.
struct TouchShape {
    /// `None` if it touches nothing.
    collider: Option<ColliderHandle>,
    surface: Option<Surface>,
    kind: TouchKind,
    /// Number of the shapes that it never touches: those of its link, or all that are fixed.
    part: usize,
    /// Index of its body in the model.
    body: usize,
    bounds: Bounds,
    /// Inverse mass and inertia of its body in the rest pose, 1/kg and 1/(kg m^2); 0 if it is fixed.
    inverse: [f64; 2],
    form: TouchForm,
}

/// Makes shapes of links that touch by rules of their own parts, since they may touch other shapes of their links.
fn separate(shapes: &mut [TouchShape], blueprint: &Blueprint) {
    for index in blueprint.contacts.pairs.iter().flat_map(|pair| pair.shapes) {
        if matches!(shapes[index].kind, TouchKind::Link(_)) {
            shapes[index].part = blueprint.links.len() + 1 + index;
        }
    }
}

/// What a shape is a part of.
#[derive(Clone, Copy, PartialEq)]
enum TouchKind {
    /// The link with this index in the blueprint.
    Link(usize),
    Base,
    Ground,
}

impl TouchKind {
    /// The link, or `links` for all that is fixed.
    fn part(self, links: usize) -> usize {
        match self {
            Self::Link(link) => link,
            Self::Base | Self::Ground => links,
        }
    }
}

/// Forms on which the points or the frame of a contact depend.
#[derive(Clone, Copy, PartialEq)]
enum TouchForm {
    Plane,
    Capsule,
    /// The height field with this index among the fixed shapes.
    Field(usize),
    Other,
}

impl Touching {
    pub(super) fn new(robot: &Robot) -> Self {
        let blueprint = &robot.blueprint;
        let inverses = &robot.layout.shape_inverses;
        let links = blueprint.links.iter().enumerate();
        let shapes = links.flat_map(|(link, plan)| {
            let kind = if plan.is_base() { TouchKind::Base } else { TouchKind::Link(link) };
            plan.shapes.iter().map(move |shape| (kind, shape))
        });
        let moving = shapes.zip(inverses).map(|((kind, shape), inverse)| TouchShape {
            collider: None,
            surface: shape.surface,
            kind,
            part: kind.part(blueprint.links.len()),
            body: shape.body,
            bounds: Bounds::of_shape(&shape.shape, &shape.pose),
            inverse: if kind == TouchKind::Base { [0.0; 2] } else { *inverse },
            form: match shape.shape {
                Shape::Capsule { .. } => TouchForm::Capsule,
                _ => TouchForm::Other,
            },
        });
        let fixed = blueprint.grounds.iter().enumerate().map(|(index, ground)| TouchShape {
            collider: None,
            surface: Some(ground.surface),
            kind: TouchKind::Ground,
            part: TouchKind::Ground.part(blueprint.links.len()),
            body: ground.body,
            bounds: match &ground.form {
                GroundForm::Plane => Bounds::Plane,
                GroundForm::Solid(shape) => Bounds::of_shape(shape, &ground.pose),
                GroundForm::Field(field) => {
                    let (shape, inside) = field.bounding_box();
                    Bounds::of_shape(&shape, &inside)
                }
            },
            inverse: [0.0; 2],
            form: match ground.form {
                GroundForm::Plane => TouchForm::Plane,
                GroundForm::Solid(Shape::Capsule { .. }) => TouchForm::Capsule,
                GroundForm::Field(_) => TouchForm::Field(index),
                GroundForm::Solid(_) => TouchForm::Other,
            },
        });
        let mut shapes: Vec<TouchShape> = moving.chain(fixed).collect();
        separate(&mut shapes, blueprint);
        for (handle, collider) in robot.template.colliders.iter() {
            shapes[shape_of(collider)].collider = Some(handle);
        }
        Self {
            shapes,
            near: Near::default(),
            pairs: Vec::new(),
            manifolds: Vec::new(),
            normals: Vec::new(),
            rules: blueprint.contacts.clone(),
            parents: (0..blueprint.links.len()).map(|link| blueprint.parent_of(link)).collect(),
            tops: blueprint.tops.clone(),
            trees: (0..blueprint.links.len()).map(|link| blueprint.tree_of(link)).collect(),
            friction: 1.0,
        }
    }

    /// Whether two shapes can touch, by MuJoCo's rules.
    fn meet(&self, pair: [usize; 2]) -> bool {
        let [first, second] = pair.map(|shape| &self.shapes[shape]);
        let is_link = |shape: &TouchShape| matches!(shape.kind, TouchKind::Link(_));
        if !is_link(first) && !is_link(second) {
            return false;
        }
        if !self.own_rules(pair).is_empty() {
            return true;
        }
        let bodies = [first.body.min(second.body), first.body.max(second.body)];
        let meets = match (first.surface, second.surface) {
            (Some(one), Some(other)) => one.meets(&other),
            _ => false,
        };
        let are_apart = match (first.kind, second.kind) {
            (TouchKind::Link(one), TouchKind::Link(other)) => {
                let is_child = |child: usize, parent| self.parents[child] == Some(parent);
                (self.rules.links_touch || self.trees[one] != self.trees[other])
                    && one != other
                    && (self.rules.parents_touch
                        || (!is_child(one, other) && !is_child(other, one)))
            }
            (TouchKind::Link(_), TouchKind::Ground) | (TouchKind::Ground, TouchKind::Link(_)) => {
                let is_land = |shape: &TouchShape| {
                    matches!(shape.form, TouchForm::Plane | TouchForm::Field(_))
                };
                // Other fixed shapes may be those of the robot's own base.
                self.rules.links_touch
                    || is_land(first)
                    || is_land(second)
                    || self.tops[first.body] != self.tops[second.body]
            }
            (TouchKind::Link(_), TouchKind::Base) | (TouchKind::Base, TouchKind::Link(_)) => {
                self.rules.links_touch || self.tops[first.body] != self.tops[second.body]
            }
            _ => false,
        };
        meets && are_apart && !self.rules.excluded.contains(&bodies)
    }

    /// The rules of a pair of shapes itself; by each of several they touch once, as in MuJoCo.
    fn own_rules(&self, [first, second]: [usize; 2]) -> &[PairPlan] {
        let shapes = [first.min(second), first.max(second)];
        let pairs = &self.rules.pairs;
        let start = pairs.partition_point(|pair| pair.shapes < shapes);
        let count = pairs[start..].partition_point(|pair| pair.shapes == shapes);
        &pairs[start..start + count]
    }

    /// Adds the contacts of all shapes. Returns whether there are no more than a step may have.
    pub(super) fn add(
        &mut self,
        blueprint: &Blueprint,
        physics: &PhysicsWorld,
        start: &Motion,
        problem: &mut ConstraintProblem,
    ) -> bool {
        self.find_pairs(physics, start);
        self.normals.clear();
        if self.pairs.len() > MOST_PAIRS {
            return false;
        }
        (0..self.pairs.len()).all(|index| {
            let pair = self.pairs[index];
            (0..self.own_rules(pair).len().max(1)).all(|rule| {
                self.add_pair(blueprint, (pair, rule, physics), start, problem);
                self.normals.len() <= MOST_CONTACTS
            })
        })
    }

    /// Finds the shapes that are close and can touch.
    fn find_pairs(&mut self, physics: &PhysicsWorld, start: &Motion) {
        let mut near = std::mem::take(&mut self.near);
        near.clear();
        for (index, shape) in self.shapes.iter().enumerate() {
            let Some(handle) = shape.collider else { continue };
            let collider = &physics.colliders[handle];
            let frame = pose_at_start(collider, shape.link(start));
            near.add([index, shape.part], &shape.bounds, &frame, collider.contact_skin());
        }
        let mut pairs = std::mem::take(&mut self.pairs);
        pairs.clear();
        near.pairs(|[one, other]| {
            let is_ground = self.shapes[one.max(other)].kind == TouchKind::Ground;
            let pair = [one.min(other), one.max(other)];
            if pairs.len() <= MOST_PAIRS && self.meet(pair) {
                pairs.push(if is_ground { [pair[1], pair[0]] } else { pair });
            }
        });
        pairs.sort_unstable();
        (self.near, self.pairs) = (near, pairs);
    }

    /// Depths, m, in which shapes are in each other that are near and can touch; negative for a distance. The shapes are
    /// counted as by [`shape_of`], of a link and a fixed shape the fixed one first.
    pub(super) fn depths(
        &mut self,
        blueprint: &Blueprint,
        physics: &PhysicsWorld,
        start: &Motion,
    ) -> Vec<([usize; 2], f32)> {
        self.find_pairs(physics, start);
        let pairs = std::mem::take(&mut self.pairs);
        let depth = |pair: [usize; 2]| {
            self.touch_pair(blueprint, (pair, 0, physics), start)?;
            let points = self.manifolds.iter().flat_map(|manifold| &manifold.points);
            Some((pair, points.map(|point| -point.dist).reduce(f32::max)?))
        };
        pairs.into_iter().filter_map(depth).collect()
    }

    /// Finds the points in which the shapes of a pair touch, by the own rule of this index if they have any. Returns their
    /// contact and the poses of their colliders; `None` if one of them touches nothing.
    fn touch_pair(
        &mut self,
        blueprint: &Blueprint,
        (pair, rule, physics): ([usize; 2], usize, &PhysicsWorld),
        start: &Motion,
    ) -> Option<(ContactPlan, [Pose; 2])> {
        let shapes = pair.map(|shape| &self.shapes[shape]);
        let [Some(one), Some(other)] = shapes.map(|shape| shape.surface) else { return None };
        let colliders = self.colliders(pair, physics)?;
        let plan = match self.own_rules(pair).get(rule) {
            Some(pair) => pair.contact,
            None => one.contact(&other, &self.rules.stated, blueprint.timestep_secs),
        };
        let plan = plan.with_friction(self.friction);
        let poses = [0, 1].map(|k| pose_at_start(colliders[k], shapes[k].link(start)));
        self.manifolds.clear();
        let between = poses[0].inv_mul(&poses[1]);
        match shapes[0].form {
            TouchForm::Field(index) => {
                let ground = &blueprint.grounds[index].form;
                touch_field((ground, colliders[1]), &between, plan.margin, &mut self.manifolds);
            }
            _ => touch(colliders, &between, plan.margin, &mut self.manifolds),
        }
        Some((plan, poses))
    }

    fn colliders<'a>(
        &self,
        pair: [usize; 2],
        physics: &'a PhysicsWorld,
    ) -> Option<[&'a Collider; 2]> {
        let [first, second] = pair.map(|shape| self.shapes[shape].collider);
        Some([&physics.colliders[first?], &physics.colliders[second?]])
    }

    fn add_pair(
        &mut self,
        blueprint: &Blueprint,
        (pair, rule, physics): ([usize; 2], usize, &PhysicsWorld),
        start: &Motion,
        problem: &mut ConstraintProblem,
    ) {
        let touched = self.touch_pair(blueprint, (pair, rule, physics), start);
        let (Some((plan, poses)), Some(colliders)) = (touched, self.colliders(pair, physics))
        else {
            return;
        };
        let shapes = pair.map(|shape| &self.shapes[shape]);
        let links = shapes.map(|shape| shape.link(start));
        let inverse = [0, 1].map(|k| shapes[0].inverse[k] + shapes[1].inverse[k]);
        let along = direction(shapes.map(|shape| shape.form), colliders, poses);
        let manifolds = std::mem::take(&mut self.manifolds);
        for manifold in &manifolds {
            let normal = poses[0].rotation * manifold.local_n1;
            for (index, point) in manifold.points.iter().enumerate() {
                if point.dist >= plan.margin || is_repeated(&manifold.points, index) {
                    continue;
                }
                let contact = Contact {
                    plan,
                    links,
                    inverse,
                    point: (poses[0] * point.local_p1 + normal * (0.5 * point.dist)).as_dvec3(),
                    axes: frame(normal, along).map(|axis| axis.as_dvec3()),
                    position: f64::from(point.dist) - f64::from(plan.margin),
                };
                self.normals.push(contact.add(blueprint, start, problem));
            }
        }
        self.manifolds = manifolds;
    }

    /// Sum of the normal forces of the contacts that were added last, N.
    pub(super) fn normal_force(&self, forces: &[f64]) -> f64 {
        self.normals.iter().flat_map(|(first, count)| &forces[*first..first + count]).sum()
    }
}

impl TouchShape {
    fn link<'a>(&self, start: &'a Motion) -> Option<&'a LinkMotion> {
        match self.kind {
            TouchKind::Link(link) => Some(&start.links[link]),
            TouchKind::Base | TouchKind::Ground => None,
        }
    }
}

fn pose_at_start(collider: &Collider, link: Option<&LinkMotion>) -> Pose {
    match (link, collider.position_wrt_parent()) {
        (Some(link), Some(inside)) => link.pose * *inside,
        _ => *collider.position(),
    }
}

/// Axis of a capsule on a plane, along which MuJoCo lays a tangent; zero for other pairs.
fn direction(forms: [TouchForm; 2], colliders: [&Collider; 2], poses: [Pose; 2]) -> Vector {
    let capsule = match forms {
        [TouchForm::Plane, TouchForm::Capsule] => 1,
        [TouchForm::Capsule, TouchForm::Plane] => 0,
        _ => return Vector::ZERO,
    };
    let shape = colliders[capsule].shape().as_capsule();
    shape.map_or(Vector::ZERO, |shape| {
        poses[capsule].rotation * (shape.segment.b - shape.segment.a).normalize_or_zero()
    })
}
