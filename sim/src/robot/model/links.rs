//! The links of a robot: bodies with joints, and what is fixed to them.

use std::ops::RangeInclusive;

use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::MassProperties;

use super::super::blueprint::{JointPlan, LinkPlan, ShapePlan};
use super::super::folder::Folder;
use super::super::frame::vector;
use super::super::inertia::{MassSum, Solid};
use super::bodies::{self, Body};
use super::context::Context;
use super::geoms::Geom;
use super::joints;
use crate::error::short;

/// Distance of a free root's mass centre from its origin that counts as none, m.
const LARGEST_OFFSET: f32 = 1e-5;
/// Largest difference of two frames that MuJoCo takes for one, m or parts of a quaternion.
const SAME_FRAME: f64 = 1e-6;

/// Masses of bodies that move, kg, and their principal moments of inertia, kg m^2: products of others leave single
/// precision.
const MASSES: RangeInclusive<f32> = 1e-12..=1e9;
const MOMENTS: RangeInclusive<f32> = 1e-13..=1e15;

/// Links, their masses, and the lines of their joints.
pub(super) struct Links<'a> {
    pub(super) plans: Vec<LinkPlan>,
    masses: Vec<MassSum>,
    /// Whether all parts of each link could be read.
    is_whole: Vec<bool>,
    /// The carried share of each link's weight; none before the first body with a mass.
    carried: Vec<Option<f64>>,
    /// The body of each link; none for the base.
    bodies: Vec<Option<&'a Body>>,
    /// The link of each body, and the body's frame in it.
    pub(super) homes: Vec<Home>,
    /// Mass centre of each body in its link. Of a body without a mass, MuJoCo takes the body's position in its parent as a
    /// point in the body's own frame; so does this.
    pub(super) mass_centres: Vec<Vector>,
}

/// Link of a body, `None` for the world, and the body's frame in it.
pub(super) type Home = (Option<usize>, Pose);

/// The links of all bodies.
pub(super) fn read<'a>(
    bodies: &'a [Body],
    context: &mut Context,
    folder: &mut Folder<'_>,
) -> Links<'a> {
    let mut links = Links {
        plans: Vec::new(),
        masses: Vec::new(),
        is_whole: Vec::new(),
        carried: Vec::new(),
        bodies: Vec::new(),
        homes: Vec::new(),
        mass_centres: vec![Vector::ZERO],
    };
    let base = links.add_base(bodies);
    links.homes.push((base, Pose::IDENTITY));
    for (index, body) in bodies.iter().enumerate().skip(1) {
        let (parent, frame) = links.homes[body.parent];
        let inside = frame * body.frame.pose();
        let home = match links.add_body(body, parent, inside, context) {
            0 => (parent, inside),
            _ => (Some(links.plans.len() - 1), Pose::IDENTITY),
        };
        links.mass_centres.push(home.1 * body.stated.pose().translation);
        if let Some(link) = home.0 {
            links.add_parts((index, body), link, &home.1, (&mut *context, &mut *folder));
        }
        links.homes.push(home);
    }
    links.find_sliders(bodies);
    if bodies.iter().all(|body| body.is_whole && body.joints.is_empty()) {
        let reason = "the model has no joints; a robot needs a body with a joint";
        context.blockers.note(reason.to_owned());
    }
    links
}

impl<'a> Links<'a> {
    /// Adds the link of all bodies that are fixed to the world, if any of them has a shape.
    fn add_base(&mut self, bodies: &[Body]) -> Option<usize> {
        let base = bodies.iter().skip(1).find(|body| body.is_static && !body.geoms.is_empty())?;
        self.push(base.name.clone(), None, Pose::IDENTITY, JointPlan::Fixed);
        self.bodies.push(None);
        Some(0)
    }

    /// Adds a body's links: one for each joint. All but the last have neither mass nor shapes. Returns their number.
    fn add_body(
        &mut self,
        body: &'a Body,
        parent: Option<usize>,
        rest: Pose,
        context: &Context,
    ) -> usize {
        let is_root = parent.is_none_or(|parent| self.plans[parent].is_base());
        let joints =
            if is_root { joints::read_root(body, context) } else { joints::read(body, context) };
        // In place of joints that cannot be built, so that the rest of the body is checked.
        let joints = if joints.is_empty() && !body.joints.is_empty() {
            vec![JointPlan::Fixed]
        } else {
            joints
        };
        let count = joints.len();
        let (mut parent, mut rest) = (parent, rest);
        for (index, joint) in joints.into_iter().enumerate() {
            let name = match &joint {
                JointPlan::Hinge(hinge) | JointPlan::Ball(hinge) if index + 1 < count => {
                    format!("{}.{}", body.name, hinge.name)
                }
                _ => body.name.clone(),
            };
            self.push(name, parent, rest, joint);
            self.bodies.push(Some(body));
            (parent, rest) = (Some(self.plans.len() - 1), Pose::IDENTITY);
        }
        count
    }

    fn push(&mut self, name: String, parent: Option<usize>, rest: Pose, joint: JointPlan) {
        let mass = MassProperties::default();
        let shapes = Vec::new();
        let (gravity_scale, is_slider) = (1.0, false);
        self.plans.push(LinkPlan {
            name,
            parent,
            rest,
            joint,
            mass,
            gravity_scale,
            is_slider,
            shapes,
        });
        self.masses.push(MassSum::default());
        self.is_whole.push(true);
        self.carried.push(None);
    }

    /// Adds the mass and the shapes of a body to its link.
    fn add_parts(
        &mut self,
        (index, body): (usize, &Body),
        link: usize,
        frame: &Pose,
        (context, folder): (&mut Context, &mut Folder<'_>),
    ) {
        let inertial = context.blockers.keep(bodies::stated_inertia(body, &context.options));
        self.is_whole[link] &= body.is_whole && inertial.is_some();
        let inertial = inertial.flatten();
        let mut solids: Vec<Solid> = inertial.iter().map(|solid| solid.placed(frame)).collect();
        let has_contacts = body.geoms.iter().any(Geom::collides);
        let only_weight = body.geoms.iter().filter(|geom| geom.weighs()).count() == 1;
        let stated = inertial.as_ref().and_then(|_| bodies::stated_frame(body, &context.options));
        let stated = stated.map(|own| frame.rotation * own.pose().rotation);
        let mut axes = None;
        let first_shape = self.plans[link].shapes.len();
        for geom in &body.geoms {
            let weighs = inertial.is_none() && geom.weighs();
            let is_drawn = geom.collides() || !(has_contacts || geom.is_mesh());
            if !weighs && !is_drawn {
                continue;
            }
            let read = geom.shape(&mut context.meshes, folder).and_then(|(shape, pose)| {
                let placed = *frame * pose;
                let solid = weighs.then(|| geom.solid(&shape, &placed, &context.meshes));
                Ok((shape, pose, solid.transpose()?))
            });
            let Some((shape, pose, solid)) = context.blockers.keep(read) else {
                self.is_whole[link] = false;
                continue;
            };
            solids.extend(solid);
            if weighs && only_weight && !geom.is_mesh() {
                axes = Some(frame.rotation * geom.axes(&pose));
            }
            if is_drawn {
                let touches = context.options.has_contacts && geom.collides();
                let surface = Some(geom.surface).filter(|_| touches);
                let mass_centre = self.mass_centres[index];
                let name = geom.name();
                let pose = *frame * pose;
                let plan = ShapePlan { name, shape, pose, surface, body: index, mass_centre };
                self.plans[link].shapes.push(plan);
            }
        }
        let found = || sum(&solids).axes_from(stated.unwrap_or(frame.rotation));
        let principal = stated.filter(|_| body.states_moments()).or(axes).unwrap_or_else(found);
        let empty = *frame * body.stated.pose();
        let solids = bounded(solids, &empty, context.options.least);
        solids.iter().for_each(|solid| self.masses[link].add(solid));
        let own = sum(&solids);
        if own.mass > 0.0 {
            let centre = vector(own.centre);
            let shapes = &mut self.plans[link].shapes[first_shape..];
            shapes.iter_mut().for_each(|shape| shape.mass_centre = centre);
            self.mass_centres[index] = centre;
            self.plans[link].is_slider = lies_in_axes(body, &own, axes);
            if body.geoms.iter().all(|geom| !geom.is_ellipsoid_in_fluid()) {
                context.options.fluid.add(link, &own, principal);
            }
            context.blockers.keep(self.carry(body, link));
        }
    }

    /// Of the links whose inertia lies in their axes, leaves those that MuJoCo counts as [`LinkPlan::is_slider`].
    fn find_sliders(&mut self, bodies: &[Body]) {
        for (index, body) in bodies.iter().enumerate().skip(1) {
            let parent = &bodies[body.parent];
            if let Some(link) = self.homes[body.parent].0 {
                self.plans[link].is_slider = false;
            }
            let is_own = |own: &Option<&Body>| own.is_some_and(|own| std::ptr::eq(own, body));
            let mut own = self.plans.iter().zip(&self.bodies).filter(|(_, of)| is_own(of));
            let slides = own.all(|(plan, _)| {
                let hinge = plan.hinge().filter(|hinge| hinge.is_slide());
                hinge.is_some_and(|hinge| {
                    hinge.axis.frame == Rotation::IDENTITY && hinge.anchor == Vector::ZERO
                })
            });
            let is_near_world = parent.is_static && parent.parent == 0;
            let is_slider = is_near_world && slides && !body.joints.is_empty();
            if let Some(link) = self.homes[index].0.filter(|_| !is_slider) {
                self.plans[link].is_slider = false;
            }
        }
    }

    /// Scales the weight of a link by the `gravcomp` of its bodies.
    fn carry(&mut self, body: &Body, link: usize) -> Result<(), String> {
        let carried = self.carried[link].get_or_insert(body.carried);
        if *carried != body.carried {
            let reason = format!(
                "`gravcomp` must be the same in all bodies of a link, another one has {carried}; set it on all, to the share \
                 of their whole weight that is carried"
            );
            return Err(body.element.refuse(reason));
        }
        self.plans[link].gravity_scale = (1.0 - *carried) as f32;
        Ok(())
    }

    /// Sets the links' mass properties. `fixed_mass` is that of bodies without a link, kg.
    pub(super) fn masses_to_links(&mut self, context: &Context, fixed_mass: f64) {
        let sum = self.masses.iter().map(|sum| sum.mass).sum::<f64>() + fixed_mass;
        let factor = context.options.total_mass.map_or(1.0, |total| total / sum);
        let roots = self.plans.iter().filter(|plan| plan.parent.is_none() && !plan.is_base());
        let is_alone = self.plans.len() > 1 && roots.count() == 1;
        let body = |link: usize| self.bodies.get(link).copied().flatten();
        for (index, (link, mass)) in self.plans.iter_mut().zip(&self.masses).enumerate() {
            link.mass = mass.properties(factor);
            if let JointPlan::Free(joint) = &link.joint
                && (!is_alone || link.mass.local_com.length() > LARGEST_OFFSET)
            {
                link.joint = JointPlan::Floating(joint.clone());
            }
            // The last link of a body has its mass.
            let Some(own) = body(index).filter(|_| self.is_whole[index]) else { continue };
            if body(index + 1).is_none_or(|next| !std::ptr::eq(own, next)) {
                context.blockers.keep(check_mass(own, &link.mass));
            }
        }
    }
}

/// All parts as one.
fn sum(solids: &[Solid]) -> Solid {
    let mut sum = MassSum::default();
    solids.iter().for_each(|solid| sum.add(solid));
    sum.solid()
}

/// Whether MuJoCo's frame of the inertia of a body is the body's frame. `axes` are those of its only shape. Otherwise MuJoCo
/// sorts the principal moments, unless the document states them.
fn lies_in_axes(body: &Body, whole: &Solid, axes: Option<Rotation>) -> bool {
    let [[x, xy, xz], [_, y, yz], [_, _, z]] = whole.inertia;
    let is_small = |number: &f64| number.abs() < SAME_FRAME;
    let is_level = match axes {
        Some(axes) => axes.xyz().length() < SAME_FRAME as f32,
        None => {
            let products = [xy, xz, yz].map(|product| product / (x + y + z));
            products.iter().all(is_small) && (body.states_moments() || (x >= y && y >= z))
        }
    };
    is_level && whole.centre.iter().all(is_small)
}

fn check_mass(body: &Body, mass: &MassProperties) -> Result<(), String> {
    let (mass, moments) = (mass.mass(), mass.principal_inertia().to_array());
    if MASSES.contains(&mass) && moments.iter().all(|own| MOMENTS.contains(own)) {
        return Ok(());
    }
    let [a, b, c] = moments;
    Err(body.element.refuse(format!(
        "a body that moves must have a mass of 1e-12 to 1e9 kg and moments of inertia of 1e-13 to 1e15 kg m^2, it has \
         {}, and {}, {} and {}; set its `inertial` or shapes",
        short(mass),
        short(a),
        short(b),
        short(c)
    )))
}

/// Parts of a body in its link, or one part in place of them, if the body has less than MuJoCo's `boundmass` or
/// `boundinertia`. As in MuJoCo, the centre of an empty body is where its own frame is in its parent, but in its own axes.
fn bounded(solids: Vec<Solid>, empty: &Pose, [mass, inertia]: [f64; 2]) -> Vec<Solid> {
    if mass <= 0.0 && inertia <= 0.0 {
        return solids;
    }
    let whole = sum(&solids);
    let enough = whole.mass >= mass && whole.principal_moments().iter().all(|own| *own >= inertia);
    if enough {
        return solids;
    }
    let centre =
        if whole.mass > 0.0 { whole.centre } else { empty.translation.to_array().map(f64::from) };
    vec![Solid { centre, ..whole.at_least(mass, inertia) }]
}

impl LinkPlan {
    /// Whether the link is fixed to the world.
    pub(crate) fn is_base(&self) -> bool {
        matches!(self.joint, JointPlan::Fixed)
    }
}
