//! The section `contact`: pairs of shapes that touch with their own properties, and pairs of bodies that do not.

use std::collections::BTreeSet;

use super::super::blueprint::{ContactRules, GroundPlan, LinkPlan, PairPlan};
use super::super::document::{Element, check_names};
use super::super::softness::Softness;
use super::super::surface::{ContactPlan, Surface};
use super::bodies::Body;
use super::context::Context;

/// Of a pair; `gap` has no effect on the motion.
const PAIR: [&str; 11] = [
    "name",
    "class",
    "geom1",
    "geom2",
    "condim",
    "friction",
    "solref",
    "solreffriction",
    "solimp",
    "margin",
    "gap",
];
/// Friction of a pair that states none, as in MuJoCo: sliding, torsional and rolling; the last three in m.
const FRICTION: [f64; 5] = [1.0, 1.0, 0.005, 0.0001, 0.0001];

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
    let known: Vec<(usize, &str)> = (0..)
        .zip(shapes)
        .filter_map(|(index, (name, surface))| surface.map(|_| (index, *name)))
        .collect();
    let shape = |key: &str| {
        let names = known.iter().map(|(_, name)| *name);
        let found = context.index(&element, key, ("shape that can touch", names))?;
        Ok::<_, String>(known[found].0)
    };
    let (first, second) = (shape("geom1")?, shape("geom2")?);
    Ok(PairPlan {
        shapes: [first.min(second), first.max(second)],
        contact: contact(&element, context)?,
    })
}

/// The contact of a pair. What the pair does not state has MuJoCo's defaults; properties of the shapes do not count.
fn contact(element: &Element, context: &Context) -> Result<ContactPlan, String> {
    let (solref, solimp) = Softness::DEFAULT;
    let solref = element.padded("solref", solref)?;
    Softness::check("solref", solref).map_err(|reason| element.refuse(reason))?;
    let dimensions = element.integer("condim", 3)?;
    let friction = element.padded("friction", FRICTION)?;
    let margin = element.number("margin", 0.0)?;
    if ![1, 3, 4, 6].contains(&dimensions) {
        return Err(element.refuse("`condim` must be 1, 3, 4 or 6"));
    }
    let solimp = element.padded("solimp", solimp)?;
    let of_friction = element.padded("solreffriction", [0.0; 2])?;
    // As in MuJoCo, two zeros are the default: the softness of the contact.
    let has_own = of_friction != [0.0; 2];
    if has_own {
        Softness::check("solreffriction", of_friction)
            .map_err(|reason| element.refuse_for("solreffriction", reason))?;
    }
    let softness = |solref| Softness::new(solref, solimp, context.options.timestep_secs);
    let plan = ContactPlan {
        dimensions: dimensions as usize,
        friction,
        margin: margin as f32,
        softness: softness(solref),
        friction_softness: has_own.then(|| softness(of_friction)),
    };
    Ok(plan.with_friction(1.0))
}
