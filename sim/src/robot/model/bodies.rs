//! The tree of bodies as a list, and their masses.

use super::super::blueprint::GroundPlan;
use super::super::document::{Element, ORIENTATIONS, check_names, check_unique};
use super::super::folder::Folder;
use super::super::frame::{Frame, IDENTITY};
use super::super::inertia::{MassSum, Solid};
use super::super::surface::Surface;
use super::context::Context;
use super::geoms::{self, Geom};
use super::joints;
use super::options::{MassSource, Options};
use crate::error::short;

/// Elements in a body that have no effect on the motion.
const SKIPPED: [&str; 2] = ["camera", "light"];

/// Most velocities of a model; the costs of a step grow with their third power.
const MOST_VELOCITIES: usize = 300;
/// Most shapes of a model; the costs of its reading grow with their square.
const MOST_SHAPES: usize = 5000;
/// Most shapes that are height fields, of which each has its own heights.
const MOST_FIELDS: usize = 8;

/// A body of the model.
pub(super) struct Body {
    pub(super) name: String,
    pub(super) element: Element,
    /// Index of the parent; the world's is its own.
    pub(super) parent: usize,
    /// Frame in the parent.
    pub(super) frame: Frame,
    /// The same without the `frame` elements around the body, where MuJoCo has the mass centre of a body without a mass.
    pub(super) stated: Frame,
    /// Whether no joint is between the body and the world.
    pub(super) is_static: bool,
    /// Share of the body's weight that a constant force carries.
    pub(super) carried: f64,
    /// Joints, and the frames in the body in which they are stated.
    pub(super) joints: Vec<(Element, Frame)>,
    pub(super) geoms: Vec<Geom>,
    /// Names of the sites that equalities connect, and their frames in the body.
    pub(super) sites: Vec<(String, Frame)>,
    inertial: Option<(Element, Frame)>,
    /// Whether all its parts could be read.
    pub(super) is_whole: bool,
}

impl Body {
    /// Whether the document states its principal moments of inertia.
    pub(super) fn states_moments(&self) -> bool {
        self.inertial.as_ref().is_some_and(|(stated, _)| stated.text("fullinertia").is_none())
    }

    /// Moves the body's frame to `inside`, a frame in it. Its shapes, sites and stated inertia stay in place.
    pub(super) fn move_frame(&mut self, inside: &Frame) {
        self.frame = self.frame.then(inside);
        self.geoms.iter_mut().for_each(|geom| geom.seen_from(inside));
        let inverse = inside.inverse();
        let sites = self.sites.iter_mut().map(|(_, frame)| frame);
        let inertial = self.inertial.iter_mut().map(|(_, frame)| frame);
        sites.chain(inertial).for_each(|frame| *frame = inverse.then(frame));
    }
}

/// All bodies, parents before their children and the world first.
pub(super) fn flat(root: &Element, context: &Context) -> Vec<Body> {
    let mut bodies = vec![new_body(root, "world".to_owned(), 0, IDENTITY)];
    for world in root.all("worldbody") {
        fill(&mut bodies, 0, world, (None, IDENTITY), context);
    }
    for index in 1..bodies.len() {
        bodies[index].is_static =
            bodies[index].joints.is_empty() && bodies[bodies[index].parent].is_static;
    }
    context.blockers.keep(check_size(&bodies));
    check_bodies(&bodies, context);
    bodies
}

/// Refuses a model that a step would take seconds for.
fn check_size(bodies: &[Body]) -> Result<(), String> {
    let velocities: usize =
        bodies.iter().flat_map(|body| &body.joints).map(joints::velocities).sum();
    let shapes: usize = bodies.iter().map(|body| body.geoms.len()).sum();
    let counts = [
        ("degrees of freedom", velocities, MOST_VELOCITIES, "joints"),
        ("shapes", shapes, MOST_SHAPES, "shapes"),
    ];
    match counts.iter().find(|(_, count, most, _)| count > most) {
        None => Ok(()),
        Some((what, count, most, parts)) => Err(format!(
            "the model has {count} {what}, at most {most} are allowed; remove bodies or {parts}"
        )),
    }
}

fn new_body(element: &Element, name: String, parent: usize, frame: Frame) -> Body {
    Body {
        name,
        element: element.alone(),
        parent,
        frame,
        stated: frame,
        is_static: true,
        carried: 0.0,
        joints: Vec::new(),
        geoms: Vec::new(),
        sites: Vec::new(),
        inertial: None,
        is_whole: true,
    }
}

/// Adds the children of an element, which is a body or a frame in it, to the body `own`.
fn fill(
    bodies: &mut Vec<Body>,
    own: usize,
    element: &Element,
    outside: (Option<&str>, Frame),
    context: &Context,
) {
    for child in &element.children {
        if context.blockers.keep(add_part(bodies, own, child, outside, context)).is_none() {
            bodies[own].is_whole = false;
        }
    }
}

fn add_part(
    bodies: &mut Vec<Body>,
    own: usize,
    child: &Element,
    (childclass, frame): (Option<&str>, Frame),
    context: &Context,
) -> Result<(), String> {
    match child.tag.as_str() {
        "geom" => {
            let geom = context.classes.resolve(child, childclass)?;
            bodies[own].geoms.push(Geom::new(geom, frame, context)?);
        }
        "joint" if own > 0 => {
            let joint = context.classes.resolve(child, childclass)?;
            bodies[own].joints.push((joint, frame));
        }
        "freejoint" if own > 0 => bodies[own].joints.push((child.clone(), frame)),
        "inertial" if own > 0 => {
            if bodies[own].inertial.replace((child.clone(), frame)).is_some() {
                return Err(child.refuse("its body has another `inertial`; remove one"));
            }
        }
        "body" => add_body(bodies, own, child, (childclass, frame), context)?,
        "frame" => {
            child.only(&[&["name", "childclass", "pos"], &ORIENTATIONS])?;
            let stated = context.blockers.keep(context.options.angles.frame(child));
            let frame = frame.then(&stated.unwrap_or(IDENTITY));
            let childclass = child.text("childclass").or(childclass);
            fill(bodies, own, child, (childclass, frame), context);
        }
        "site" => {
            let site = context.classes.resolve(child, childclass)?;
            let ends = geoms::ends(&site)?;
            let name = child.text("name").filter(|name| context.sites.contains(*name));
            let Some(name) = name else { return Ok(()) };
            let same = "`fromto` names the same point twice; set two different ones";
            let inside = match ends {
                Some(ends) => Frame::between(ends).ok_or_else(|| site.refuse_for("fromto", same)),
                None => context.options.angles.frame(&site),
            };
            bodies[own].sites.push((name.to_owned(), frame.then(&inside?)));
        }
        tag if SKIPPED.contains(&tag) => {}
        _ => return Err(child.refuse_element()),
    }
    Ok(())
}

fn add_body(
    bodies: &mut Vec<Body>,
    parent: usize,
    element: &Element,
    (childclass, frame): (Option<&str>, Frame),
    context: &Context,
) -> Result<(), String> {
    let known = ["name", "pos", "childclass", "mocap", "gravcomp", "user", "sleep"];
    context.blockers.keep(element.only(&[&known, &ORIENTATIONS]));
    let index = bodies.len();
    let name = element.text("name").map_or_else(|| format!("body {index}"), str::to_owned);
    let own = context.blockers.keep(context.options.angles.frame(element));
    let own = own.unwrap_or(IDENTITY);
    let mut body = new_body(element, name, parent, frame.then(&own));
    body.stated = own;
    body.carried = context.blockers.keep(element.number("gravcomp", 0.0)).unwrap_or_default();
    bodies.push(body);
    let childclass = element.text("childclass").or(childclass);
    fill(bodies, index, element, (childclass, IDENTITY), context);
    let is_fixed_to_world = parent == 0 && bodies[index].joints.is_empty();
    if context.blockers.keep(element.flag("mocap")).flatten() == Some(true) && !is_fixed_to_world {
        let reason = "a mocap body is in the `worldbody` itself and has no joint; remove `mocap`";
        context.blockers.keep::<()>(Err(element.refuse_for("mocap", reason)));
    }
    Ok(())
}

/// Mass and inertia that `inertial` states, in the body's frame; `None` if those of the shapes count, of which one must weigh.
pub(super) fn stated_inertia(body: &Body, options: &Options) -> Result<Option<Solid>, String> {
    let weighs = |geom: &Geom| geom.weighs() && !geom.is_ground();
    match (&body.inertial, options.mass_source) {
        (_, MassSource::Shapes) if body.geoms.iter().any(weighs) => Ok(None),
        (None, MassSource::Shapes | MassSource::Stated) => Ok(None),
        (Some((element, frame)), _) => read_inertial(element, frame, options).map(Some),
        (None, MassSource::Inertials) => Ok(Some(Solid::default())),
    }
}

/// Frame in which a body states its inertia, in its own; `None` if it states none.
pub(super) fn stated_frame(body: &Body, options: &Options) -> Option<Frame> {
    let (element, frame) = body.inertial.as_ref()?;
    Some(frame.then(&options.angles.frame(element).ok()?))
}

/// Mass, mass centre and inertia of a body in its frame: those that it states, or those of its shapes.
pub(super) fn solid(
    body: &Body,
    context: &mut Context,
    folder: &mut Folder<'_>,
) -> Result<Solid, String> {
    if let Some(stated) = stated_inertia(body, &context.options)? {
        return Ok(stated);
    }
    let mut sum = MassSum::default();
    for geom in body.geoms.iter().filter(|geom| geom.weighs() && !geom.is_ground()) {
        let (shape, pose) = geom.shape(&mut context.meshes, folder)?;
        sum.add(&geom.solid(&shape, &pose, &context.meshes)?);
    }
    Ok(sum.solid())
}

/// Mass of the bodies that are fixed to the world and belong to no link, kg. Only `settotalmass` needs it: without it, 0.
pub(super) fn fixed_mass(bodies: &[Body], context: &mut Context, folder: &mut Folder<'_>) -> f64 {
    if context.options.total_mass.is_none() {
        return 0.0;
    }
    let fixed = bodies.iter().skip(1).filter(|body| body.is_static);
    let shapes = fixed.clone().flat_map(|body| &body.geoms);
    for field in shapes.clone().filter(|geom| geom.is_field() && geom.weighs()) {
        let reason = "its mass would count for `settotalmass`: set mass=\"0\"";
        context.blockers.note(field.element.refuse(reason));
    }
    if has_base(bodies) && shapes.clone().any(|geom| !geom.is_ground()) {
        return 0.0;
    }
    let least = context.options.least[0];
    fixed.fold(0.0, |sum, body| {
        let own = solid(body, context, folder);
        sum + context.blockers.keep(own).map_or(0.0, |own| own.mass.max(least))
    })
}

fn read_inertial(element: &Element, frame: &Frame, options: &Options) -> Result<Solid, String> {
    let known = ["pos", "mass", "diaginertia", "fullinertia"];
    element.only(&[&known, &ORIENTATIONS])?;
    if element.text("pos").is_none() || element.text("mass").is_none() {
        return Err(element.refuse("it must have `pos` and `mass`; add them"));
    }
    let mass = element.number("mass", 0.0)?;
    let mut solid = match (element.numbers("diaginertia")?, element.numbers("fullinertia")?) {
        (Some(principal), None) => Solid::principal(mass, principal),
        (None, Some([xx, yy, zz, xy, xz, yz])) => {
            let inertia = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
            Solid { mass, centre: [0.0; 3], inertia }
        }
        (None, None) => Solid::principal(mass, [0.0; 3]),
        (Some(_), Some(_)) => {
            return Err(element.refuse("it has both `diaginertia` and `fullinertia`; remove one"));
        }
    };
    let mut moments = solid.principal_moments();
    moments.sort_by(f64::total_cmp);
    let [low, middle, high] = moments.map(|moment| moment.max(options.least[1]));
    if moments[0] < 0.0 {
        let reason = "the principal moments of `fullinertia` must not be negative; correct it";
        return Err(element.refuse_for("fullinertia", reason));
    }
    // The rounding of principal axes is no reason.
    if low + middle < high * (1.0 - 1e-12) && options.balances {
        solid = Solid::principal(mass, [(low + middle + high) / 3.0; 3]);
    } else if low + middle < high * (1.0 - 1e-12) {
        let [low, middle, high] = [low, middle, high].map(short);
        return Err(element.refuse(format!(
            "of the principal moments {low}, {middle} and {high} none may exceed the sum of the others; correct them, or set \
             all to their mean, as MuJoCo's `balanceinertia` does"
        )));
    }
    let frame = frame.then(&options.angles.frame(element)?);
    solid = solid.turned(frame.rotation);
    Ok(Solid { centre: frame.position, ..solid })
}

/// Whether bodies that are fixed to the world are a link.
pub(super) fn has_base(bodies: &[Body]) -> bool {
    !bodies.iter().any(|body| body.joints.iter().any(joints::is_free))
}

/// For each body, the child of the world that it is or is in; the world's is the world.
pub(super) fn tops(bodies: &[Body]) -> Vec<usize> {
    let mut tops = Vec::new();
    for (index, body) in bodies.iter().enumerate() {
        tops.push(if body.parent == 0 { index } else { tops[body.parent] });
    }
    tops
}

/// Removes planes, height fields, the world's shapes and, without a base, those of bodies that are fixed to the world from the bodies.
/// Returns those that something can touch.
pub(super) fn take_grounds(
    bodies: &mut [Body],
    context: &mut Context,
    folder: &mut Folder<'_>,
) -> Vec<GroundPlan> {
    let (has_base, has_contacts) = (has_base(bodies), context.options.has_contacts);
    let mut moving: Vec<Surface> = Vec::new();
    for body in bodies.iter_mut().filter(|body| !body.is_static) {
        for ground in body.geoms.iter().filter(|geom| geom.is_ground()) {
            let what = if ground.is_field() { "a height field" } else { "a plane" };
            let reason = format!("{what} must be fixed to the world: move it there, or use a box");
            context.blockers.note(ground.element.refuse(reason));
            body.is_whole = false;
        }
        moving.extend(body.geoms.iter().map(|geom| geom.surface));
    }
    let (mut grounds, mut frames) = (Vec::new(), Vec::new());
    let mut fields = 0;
    for (index, body) in bodies.iter_mut().enumerate() {
        let parent = if index == 0 { IDENTITY } else { frames[body.parent] };
        frames.push(if index == 0 { IDENTITY } else { parent.then(&body.frame) });
        let is_taken = index == 0 || (body.is_static && !has_base);
        let (taken, kept): (Vec<Geom>, Vec<Geom>) = std::mem::take(&mut body.geoms)
            .into_iter()
            .partition(|geom| is_taken || geom.is_ground());
        body.geoms = kept;
        let touched = |geom: &&Geom| geom.meets(&moving);
        let is_used = has_contacts && body.is_static;
        for geom in taken.iter().filter(|_| is_used).filter(touched) {
            fields += usize::from(geom.is_field());
            if geom.is_field() && fields > MOST_FIELDS {
                let reason = format!("a world may have {MOST_FIELDS} height fields; remove others");
                context.blockers.note(geom.element.refuse(reason));
                continue;
            }
            let ground = geom.ground((&frames[index], index), &mut *context, folder);
            grounds.extend(context.blockers.keep(ground));
        }
    }
    grounds
}

/// Refuses two bodies, joints or shapes of the same name.
fn check_bodies(bodies: &[Body], context: &Context) {
    let named = bodies.iter().map(|body| (&body.element, body.name.as_str()));
    context.blockers.keep(check_unique(named));
    let joints = bodies.iter().flat_map(|body| &body.joints).map(|(joint, _)| joint);
    context.blockers.keep(check_names(joints));
    let shapes = bodies.iter().flat_map(|body| &body.geoms).map(|geom| &geom.element);
    context.blockers.keep(check_names(shapes));
}
