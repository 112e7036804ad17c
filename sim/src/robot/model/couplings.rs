//! Fixed tendons, and equality constraints of joints and tendons.

use rapier3d::math::Pose;

use super::super::blueprint::LinkPlan;
use super::super::coupling::{
    Combination, ConnectedFrame, ConnectionPlan, Coupled, EqualityPlan, TendonPlan,
};
use super::super::document::Element;
use super::super::frame::{Frame, normalized, vector};
use super::bodies::Body;
use super::context::Context;
use super::joints;
use super::links::Links;

const TENDON: [&str; 21] = [
    "name",
    "class",
    "limited",
    "range",
    "margin",
    "solreflimit",
    "solimplimit",
    "solreffriction",
    "solimpfriction",
    "frictionloss",
    "springlength",
    "stiffness",
    "damping",
    "armature",
    "actuatorfrcrange",
    "actuatorfrclimited",
    // Without effect on the motion.
    "group",
    "width",
    "material",
    "rgba",
    "user",
];
const EQUALITY: [&str; 11] = [
    "name", "class", "active", "solref", "solimp", "joint1", "joint2", "tendon1", "tendon2",
    "polycoef", "user",
];
const CONNECTION: [&str; 9] =
    ["name", "class", "active", "solref", "solimp", "body1", "body2", "anchor", "user"];
const SITES: [&str; 8] = ["name", "class", "active", "solref", "solimp", "site1", "site2", "user"];
const WELD: [&str; 2] = ["relpose", "torquescale"];
/// Terms that act on a spatial tendon.
const PASSIVE: [&str; 5] = ["stiffness", "damping", "frictionloss", "range", "armature"];

/// Reads all tendons.
pub(super) fn tendons(root: &Element, context: &Context, links: &[LinkPlan]) -> Vec<TendonPlan> {
    let elements = root.all("tendon").flat_map(|section| &section.children);
    let read = |element: &Element| {
        let resolved = context.classes.resolve_as("tendon", &element.alone(), None)?;
        match element.tag.as_str() {
            "fixed" => fixed(&resolved, element, context, links).map(Some),
            // One without forces only measures.
            _ if !PASSIVE.iter().any(|name| acts(&resolved, name)) => Ok(None),
            _ => {
                let reason = "a spatial tendon with forces or limits is not supported; remove it";
                Err(element.refuse(reason))
            }
        }
    };
    elements.filter_map(|element| context.blockers.keep(read(element)).flatten()).collect()
}

/// Whether an attribute has another number than 0, and is no range without a limit.
fn acts(element: &Element, name: &str) -> bool {
    if name == "range" && element.text("limited") == Some("false") {
        return false;
    }
    let mut numbers = element.text(name).unwrap_or_default().split_ascii_whitespace();
    numbers.any(|number| number.parse() != Ok(0.0_f64))
}

fn fixed(
    tendon: &Element,
    element: &Element,
    context: &Context,
    links: &[LinkPlan],
) -> Result<TendonPlan, String> {
    tendon.only(&[&TENDON])?;
    for name in ["armature", "actuatorfrcrange"] {
        if tendon.list(name)?.is_some_and(|numbers| numbers.iter().any(|number| *number != 0.0)) {
            return Err(tendon
                .refuse_for(name, format!("`{name}` of a tendon is not supported; remove it")));
        }
    }
    let hinges = joints::hinges(links);
    let (mut terms, mut reference, mut at_springs) = (Vec::new(), 0.0, 0.0);
    for part in &element.children {
        part.only(&[&["joint", "coef"]])?;
        let known = joints::names(&hinges);
        let index = context.index(part, "joint", ("hinge or slide", known))?;
        if terms.iter().any(|(other, _)| *other == index) {
            return Err(part.refuse("its tendon has this joint twice; add the two `coef` up"));
        }
        let factor = part.number("coef", 1.0)?;
        reference += factor * f64::from(hinges[index].reference);
        at_springs += factor as f32 * hinges[index].spring_rest;
        terms.push((index, factor as f32));
    }
    if terms.is_empty() {
        return Err(tendon.refuse("it moves no joint; add a <joint> to it"));
    }
    let length = |end: f64| (end - reference) as f32;
    let range = context.limits(tendon, length)?;
    let number = |name: &str| joints::number(tendon, name);
    let slack = spring_length(tendon)?.map(|ends| ends.map(length));
    Ok(TendonPlan {
        name: tendon.text("name").unwrap_or_default().to_owned(),
        moved: Combination(terms.into()),
        reference: reference as f32,
        range,
        margin: number("margin")?,
        limit: joints::softness(tendon, ["solreflimit", "solimplimit"], context)?,
        stiffness: number("stiffness")?,
        slack: slack.unwrap_or([at_springs; 2]),
        damping: number("damping")?,
        friction: context.friction(tendon)?,
        friction_softness: joints::softness(tendon, ["solreffriction", "solimpfriction"], context)?,
    })
}

/// Lengths between which a tendon's spring is slack; `None` if it rests where the springs of its joints do.
fn spring_length(tendon: &Element) -> Result<Option<[f64; 2]>, String> {
    let ends = match tendon.list("springlength")?.as_deref() {
        None => return Ok(None),
        Some(&[length]) => [length; 2],
        Some(&[low, high]) if low <= high => [low, high],
        Some(_) => {
            let reason = "`springlength` must be one length, or two that ascend";
            return Err(tendon.refuse_for("springlength", reason));
        }
    };
    Ok(Some(ends).filter(|ends| *ends != [-1.0; 2]))
}

/// Reads all active equalities of joints and tendons.
pub(super) fn equalities(
    root: &Element,
    context: &Context,
    links: &[LinkPlan],
    tendons: &[TendonPlan],
) -> Vec<EqualityPlan> {
    let elements = active(root, context).into_iter().filter(|element| !is_connection(element));
    let read = |element: Element| equality(&element, context, links, tendons);
    elements.filter_map(|element| context.blockers.keep(read(element))).collect()
}

/// Reads all active equalities of points and frames.
pub(super) fn connections(
    root: &Element,
    context: &Context,
    bodies: &[Body],
    links: &Links<'_>,
) -> Vec<ConnectionPlan> {
    let elements = active(root, context).into_iter().filter(is_connection);
    let read = |element: Element| connection(&element, context, bodies, links);
    elements.filter_map(|element| context.blockers.keep(read(element))).collect()
}

fn is_connection(element: &Element) -> bool {
    ["connect", "weld"].contains(&element.tag.as_str())
}

/// Active elements of the section, with the attributes of their classes.
fn active(root: &Element, context: &Context) -> Vec<Element> {
    let read = |element: &Element| {
        let resolved = context.classes.resolve_as("equality", element, None)?;
        let is_active = resolved.flag("active")? != Some(false);
        Ok(Some(resolved).filter(|_| is_active && context.options.has_equalities))
    };
    let elements = root.all("equality").flat_map(|section| &section.children);
    elements.filter_map(|element| context.blockers.keep(read(element)).flatten()).collect()
}

fn connection(
    element: &Element,
    context: &Context,
    bodies: &[Body],
    links: &Links<'_>,
) -> Result<ConnectionPlan, String> {
    let is_weld = element.tag == "weld";
    let names_sites = element.text("site1").or(element.text("site2")).is_some();
    let ends = match (names_sites, is_weld) {
        (true, _) => {
            element.only(&[&SITES, if is_weld { &WELD[1..] } else { &[] }])?;
            let [first, second] = ["site1", "site2"].map(|key| site(element, key, context, bodies));
            [first?, second?]
                .map(|(body, frame)| end(links, body, links.homes[body].1 * frame.pose()))
        }
        (false, true) => {
            element.only(&[&CONNECTION, &WELD])?;
            // The anchor is a point of the second body, whose frame is the other end's.
            let [first, second] = connected(element, context, bodies)?;
            let anchor = element.numbers("anchor")?.unwrap_or_default();
            let [held, other] = held_ends(element, links, [second, first], anchor)?;
            [other, held]
        }
        (false, false) => {
            element.only(&[&CONNECTION])?;
            let pair = connected(element, context, bodies)?;
            let anchor = element.numbers("anchor")?;
            let anchor = anchor.ok_or_else(|| element.refuse("it must have `anchor`; add it"))?;
            held_ends(element, links, pair, anchor)?
        }
    };
    Ok(ConnectionPlan {
        ends,
        torque_scale: is_weld.then(|| element.number("torquescale", 1.0)).transpose()?,
        softness: joints::softness(element, ["solref", "solimp"], context)?,
    })
}

/// The bodies that a connection names; the second is the world unless stated.
fn connected(element: &Element, context: &Context, bodies: &[Body]) -> Result<[usize; 2], String> {
    let body = |attribute: &str| {
        context.index(element, attribute, ("body", bodies.iter().map(|body| body.name.as_str())))
    };
    let first = body("body1")?;
    let second = element.text("body2").map_or(Ok(0), |_| body("body2"))?;
    if first == second {
        return Err(element.refuse("it connects a body with itself; name another `body2`"));
    }
    Ok([first, second])
}

/// Body and frame of the site that an attribute names.
pub(super) fn site(
    element: &Element,
    attribute: &str,
    context: &Context,
    bodies: &[Body],
) -> Result<(usize, Frame), String> {
    let sites = bodies.iter().enumerate();
    let sites: Vec<_> = sites
        .flat_map(|(index, body)| body.sites.iter().map(move |(name, frame)| (name, index, *frame)))
        .collect();
    let known = sites.iter().map(|(name, ..)| name.as_str());
    let (_, body, frame) = sites[context.index(element, attribute, ("site", known))?];
    Ok((body, frame))
}

/// The end of a connection of a body with this frame in its link.
fn end(links: &Links<'_>, body: usize, in_link: Pose) -> ConnectedFrame {
    ConnectedFrame {
        link: links.homes[body].0,
        point: in_link.translation,
        rotation: in_link.rotation,
        mass_centre: links.mass_centres[body],
    }
}

/// The end at a point of the body `held`, and that in `other`, which is there in the rest pose unless `relpose` is stated.
fn held_ends(
    element: &Element,
    links: &Links<'_>,
    [held, other]: [usize; 2],
    anchor: [f64; 3],
) -> Result<[ConnectedFrame; 2], String> {
    let [(held_link, held_home), (other_link, other_home)] =
        [links.homes[held], links.homes[other]];
    let at = Pose::from_translation(vector(anchor));
    let in_other = match relative_pose(element)? {
        Some(pose) => other_home * pose,
        None => {
            let frames = rest_frames(&links.plans);
            let frame = |link: Option<usize>| link.map_or(Pose::IDENTITY, |link| frames[link]);
            frame(other_link).inverse() * (frame(held_link) * held_home * at)
        }
    };
    Ok([end(links, held, held_home * at), end(links, other, in_other)])
}

/// The `relpose` of a weld, the frame of the second body in the first; `None` for that of the rest pose.
fn relative_pose(element: &Element) -> Result<Option<Pose>, String> {
    let [x, y, z, w, a, b, c] = element.numbers("relpose")?.unwrap_or_default();
    let rotation = normalized([a, b, c, w]);
    Ok(rotation.map(|rotation| Frame { position: [x, y, z], rotation }.pose()))
}

/// Frames of the links in the world in the rest pose.
fn rest_frames(links: &[LinkPlan]) -> Vec<Pose> {
    let mut frames: Vec<Pose> = Vec::with_capacity(links.len());
    for link in links {
        let parent = link.parent.map_or(Pose::IDENTITY, |parent| frames[parent]);
        frames.push(parent * link.rest);
    }
    frames
}

fn equality(
    element: &Element,
    context: &Context,
    links: &[LinkPlan],
    tendons: &[TendonPlan],
) -> Result<EqualityPlan, String> {
    let is_joint = match element.tag.as_str() {
        "joint" => true,
        "tendon" => false,
        _ => {
            let reason = "only equalities of joints, of fixed tendons, `connect` and `weld` are supported; remove it, or \
                set active=\"false\"";
            return Err(element.refuse(reason));
        }
    };
    element.only(&[&EQUALITY])?;
    let (kind, known): (_, Vec<&str>) = if is_joint {
        ("hinge or slide", joints::names(&joints::hinges(links)).collect())
    } else {
        ("fixed tendon", tendons.iter().map(|tendon| tendon.name.as_str()).collect())
    };
    let side = |attribute: &str| {
        let index = context.index(element, attribute, (kind, known.iter().copied()))?;
        Ok::<_, String>(if is_joint { Coupled::Hinge(index) } else { Coupled::Tendon(index) })
    };
    let [first, second] = if is_joint { ["joint1", "joint2"] } else { ["tendon1", "tendon2"] };
    if element.text(first) == element.text(second) && element.text(first).is_some() {
        return Err(element.refuse(format!("`{first}` and `{second}` are the same; change one")));
    }
    Ok(EqualityPlan {
        first: side(first)?,
        second: element.text(second).map(|_| side(second)).transpose()?,
        polynomial: element.padded("polycoef", [0.0, 1.0, 0.0, 0.0, 0.0])?,
        softness: joints::softness(element, ["solref", "solimp"], context)?,
    })
}
