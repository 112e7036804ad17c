//! The tree of bodies as a list, and stated inertias.

use super::super::document::{Element, ORIENTATIONS, check_names};
use super::super::frame::{Frame, IDENTITY};
use super::super::inertia::Solid;
use super::context::Context;
use super::geoms::{Geom, Ground};
use super::options::{MassSource, Options};

/// Elements in a body that have no effect on the motion.
const SKIPPED: [&str; 3] = ["site", "camera", "light"];

/// A body of the model.
pub(super) struct Body {
    pub(super) name: String,
    pub(super) element: Element,
    /// Index of the parent; the world's is its own.
    pub(super) parent: usize,
    /// Frame in the parent.
    pub(super) frame: Frame,
    /// Whether no joint is between the body and the world.
    pub(super) is_static: bool,
    /// Joints, and the frames in the body in which they are stated.
    pub(super) joints: Vec<(Element, Frame)>,
    pub(super) geoms: Vec<Geom>,
    inertial: Option<(Element, Frame)>,
}

/// All bodies, parents before their children and the world first.
pub(super) fn flat(root: &Element, context: &Context) -> Result<Vec<Body>, String> {
    let mut bodies = vec![new_body(root, "world".to_owned(), 0, IDENTITY)];
    for world in root.all("worldbody") {
        let childclass = world.text("childclass");
        fill(&mut bodies, 0, world, (childclass, IDENTITY), context)?;
    }
    for index in 1..bodies.len() {
        bodies[index].is_static =
            bodies[index].joints.is_empty() && bodies[bodies[index].parent].is_static;
    }
    check_bodies(&bodies[1..])?;
    Ok(bodies)
}

fn new_body(element: &Element, name: String, parent: usize, frame: Frame) -> Body {
    Body {
        name,
        element: element.alone(),
        parent,
        frame,
        is_static: true,
        joints: Vec::new(),
        geoms: Vec::new(),
        inertial: None,
    }
}

/// Adds the children of an element, which is a body or a frame in it, to the body `own`.
fn fill(
    bodies: &mut Vec<Body>,
    own: usize,
    element: &Element,
    (childclass, frame): (Option<&str>, Frame),
    context: &Context,
) -> Result<(), String> {
    for child in &element.children {
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
                    return Err(child.refuse("its body has another `inertial`"));
                }
            }
            "body" => add_body(bodies, own, child, (childclass, frame), context)?,
            "frame" => {
                child.only(&[&["name", "childclass", "pos"], &ORIENTATIONS])?;
                let frame = frame.then(&context.options.angles.frame(child)?);
                let childclass = child.text("childclass").or(childclass);
                fill(bodies, own, child, (childclass, frame), context)?;
            }
            tag if SKIPPED.contains(&tag) => {}
            _ => return Err(child.refuse("this element is not supported")),
        }
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
    element.only(&[&known, &ORIENTATIONS])?;
    if element.flag("mocap")? == Some(true) {
        return Err(element.refuse("mocap bodies are not supported"));
    }
    if element.number("gravcomp", 0.0)? != 0.0 {
        return Err(element.refuse("gravity compensation is not supported"));
    }
    let index = bodies.len();
    let name = element.text("name").map_or_else(|| format!("body {index}"), str::to_owned);
    let frame = frame.then(&context.options.angles.frame(element)?);
    bodies.push(new_body(element, name, parent, frame));
    let childclass = element.text("childclass").or(childclass);
    fill(bodies, index, element, (childclass, IDENTITY), context)
}

/// Mass and inertia that `inertial` states, in the body's frame; `None` if those of the shapes count.
pub(super) fn stated_inertia(body: &Body, options: &Options) -> Result<Option<Solid>, String> {
    match (&body.inertial, options.mass_source) {
        (_, MassSource::Shapes) | (None, MassSource::Stated) => Ok(None),
        (Some((element, frame)), _) => read_inertial(element, frame, options).map(Some),
        (None, MassSource::Inertials) => Ok(Some(Solid::default())),
    }
}

fn read_inertial(element: &Element, frame: &Frame, options: &Options) -> Result<Solid, String> {
    let known = ["pos", "mass", "diaginertia", "fullinertia"];
    element.only(&[&known, &ORIENTATIONS])?;
    if element.text("pos").is_none() || element.text("mass").is_none() {
        return Err(element.refuse("it must have `pos` and `mass`"));
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
            return Err(element.refuse("it has both `diaginertia` and `fullinertia`"));
        }
    };
    if mass < 0.0 || solid.principal_moments().iter().any(|moment| *moment < 0.0) {
        return Err(element.refuse("mass and inertia must not be negative"));
    }
    let frame = frame.then(&options.angles.frame(element)?);
    solid = solid.turned(frame.rotation);
    Ok(Solid { centre: frame.position, ..solid })
}

/// Removes the world's shapes from the list of bodies and finds the floor among them.
pub(super) fn take_ground(
    bodies: &mut [Body],
    context: &Context,
) -> Result<Option<Ground>, String> {
    let mut ground = None;
    let mut frames: Vec<Frame> = Vec::new();
    for index in 0..bodies.len() {
        let parent = if index == 0 { IDENTITY } else { frames[bodies[index].parent] };
        frames.push(if index == 0 { IDENTITY } else { parent.then(&bodies[index].frame) });
        let is_static = bodies[index].is_static;
        let loose = |geom: &&Geom| geom.is_plane() && !is_static;
        if let Some(plane) = bodies[index].geoms.iter().find(loose) {
            return Err(plane.element.refuse("a plane must be fixed to the world"));
        }
        for plane in bodies[index].geoms.iter().filter(|geom| geom.is_plane() && geom.collides()) {
            if ground.is_some() {
                return Err(plane.element.refuse("the world has more than one plane"));
            }
            ground = Some(plane.ground(&frames[index], context));
        }
        bodies[index].geoms.retain(|geom| !geom.is_plane());
    }
    let moving = || bodies.iter().filter(|body| !body.is_static).flat_map(|body| &body.geoms);
    let touched = |geom: &&Geom| moving().any(|other| geom.meets(other));
    if let Some(geom) = bodies[0].geoms.iter().find(touched) {
        return Err(geom.element.refuse("links touch nothing in the world but one plane"));
    }
    bodies[0].geoms.clear();
    Ok(ground.filter(|_| context.options.has_contacts))
}

/// Refuses two bodies, joints or actuators of the same name.
fn check_bodies(bodies: &[Body]) -> Result<(), String> {
    check_names(bodies.iter().map(|body| &body.element))?;
    check_names(bodies.iter().flat_map(|body| &body.joints).map(|(joint, _)| joint))
}
