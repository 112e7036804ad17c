//! The section `contact`: pairs of shapes that touch with their own properties, and pairs of bodies that do not.

use std::collections::BTreeSet;

use super::super::blueprint::{ContactRules, GroundPlan, LinkPlan, PairPlan};
use super::super::document::{Element, check_names};
use super::super::softness::Softness;
use super::super::surface::{ContactPlan, Surface};
use super::bodies::Body;
use super::context::Context;

/// Of a pair; `gap` has no effect on the motion.
const PAIR: [&str; 10] =
    ["name", "class", "geom1", "geom2", "condim", "friction", "solref", "solimp", "margin", "gap"];

/// Names of all shapes in pairs.
pub(super) fn paired(root: &Element) -> BTreeSet<String> {
    let shapes = of(root, "pair").flat_map(|pair| [pair.text("geom1"), pair.text("geom2")]);
    shapes.flatten().map(str::to_owned).collect()
}

fn of<'a>(root: &'a Element, tag: &'a str) -> impl Iterator<Item = &'a Element> {
    root.all("contact").flat_map(move |section| section.all(tag))
}

/// Completes the rules for contacts.
pub(super) fn read(
    root: &Element,
    context: &Context,
    bodies: &[Body],
    (links, grounds): (&[LinkPlan], &[GroundPlan]),
) -> ContactRules {
    let mut rules = context.options.contacts.clone();
    let shapes = links.iter().flat_map(|link| &link.shapes);
    let shapes = shapes.map(|shape| (shape.name.as_str(), shape.surface));
    let grounds = grounds.iter().map(|ground| (ground.name.as_str(), Some(ground.surface)));
    let shapes: Vec<(&str, Option<Surface>)> = shapes.chain(grounds).collect();
    for tag in ["pair", "exclude"] {
        context.blockers.keep(check_names(of(root, tag)));
    }
    for element in of(root, "pair").filter(|_| context.options.has_contacts) {
        rules.pairs.extend(context.blockers.keep(pair(element, context, &shapes)));
    }
    rules.pairs.sort_by_key(|pair| pair.shapes);
    for element in of(root, "exclude") {
        rules.excluded.extend(context.blockers.keep(exclusion(element, context, bodies)));
    }
    rules
}

/// Bodies that do not touch.
fn exclusion(element: &Element, context: &Context, bodies: &[Body]) -> Result<[usize; 2], String> {
    element.only(&[&["name", "body1", "body2"]])?;
    let body = |key: &str| {
        context.index(element, key, ("body", bodies.iter().map(|body| body.name.as_str())))
    };
    let [one, other] = [body("body1")?, body("body2")?];
    Ok([one.min(other), one.max(other)])
}

fn pair(
    element: &Element,
    context: &Context,
    shapes: &[(&str, Option<Surface>)],
) -> Result<PairPlan, String> {
    let element = context.classes.resolve(element, None)?;
    element.only(&[&PAIR])?;
    let known: Vec<(usize, Surface, &str)> = (0..)
        .zip(shapes)
        .filter_map(|(index, (name, surface))| Some((index, (*surface)?, *name)))
        .collect();
    let shape = |key: &str| {
        let names = known.iter().map(|(.., name)| *name);
        let found = context.index(&element, key, ("shape that can touch", names))?;
        let (index, surface, _) = known[found];
        Ok::<_, String>((index, surface))
    };
    let ((first, one), (second, other)) = (shape("geom1")?, shape("geom2")?);
    let step_secs = context.options.timestep_secs;
    let contact = one.contact(&other, &context.options.contacts.stated, step_secs);
    Ok(PairPlan {
        shapes: [first.min(second), first.max(second)],
        contact: stated(&element, contact, (&one, &other), step_secs)?,
    })
}

/// A contact of two shapes with the numbers that the pair states. Their margins do not count, as in MuJoCo.
fn stated(
    element: &Element,
    contact: ContactPlan,
    (one, other): (&Surface, &Surface),
    step_secs: f64,
) -> Result<ContactPlan, String> {
    let (solref, solimp) = one.softness(other);
    let solref = element.padded("solref", solref)?;
    Softness::check("solref", solref).map_err(|reason| element.refuse(reason))?;
    let dimensions = element.integer("condim", contact.dimensions as i64)?;
    let friction = element.padded("friction", contact.friction)?;
    let margin = element.number("margin", 0.0)?;
    if ![1, 3, 4, 6].contains(&dimensions) {
        return Err(element.refuse("`condim` must be 1, 3, 4 or 6"));
    }
    let softness = Softness::new(solref, element.padded("solimp", solimp)?, step_secs);
    let plan =
        ContactPlan { dimensions: dimensions as usize, friction, margin: margin as f32, softness };
    Ok(plan.with_friction(1.0))
}
