//! Reads a robot's blueprint from an MJCF document. Elements without a physical meaning are skipped; all others that
//! cannot be built are errors with their line.

mod actuators;
mod blockers;
mod bodies;
mod context;
mod couplings;
mod flat;
mod geoms;
mod joints;
mod keyframes;
mod links;
mod meshes;
mod options;

use super::blueprint::{Blueprint, Law};
use super::document::Element;
use super::folder::Folder;
use bodies::Body;
use context::Context;
pub(super) use flat::flat;
use geoms::Geom;

/// Reads an MJCF document and the files of `folder` that it needs.
pub(super) fn read(mjcf: &str, folder: &mut Folder<'_>) -> Result<Blueprint, String> {
    let root = Element::parse(mjcf, folder)?;
    let (mut context, mut left_out) = Context::read(&root)?;
    let mut bodies = bodies::flat(&root, &context)?;
    let grounds = bodies::take_grounds(&mut bodies, &mut context, folder);
    let mut links = links::read(&bodies, &mut context, folder)?;
    if context.options.has_contacts {
        note_contacts(&bodies, &mut left_out);
    }
    if context.blockers.is_empty() {
        links.masses_to_links(context.options.total_mass)?;
    }
    let tendons = couplings::tendons(&root, &context, &links.plans);
    let equalities = couplings::equalities(&root, &context, &links.plans, &tendons);
    let connections = couplings::connections(&root, &context, &bodies, &links);
    let motors = actuators::read(&root, &context, &bodies, (&links, &tendons));
    let keyframes = keyframes::read(&root, &context.blockers);
    context.blockers.finish()?;
    Ok(Blueprint {
        timestep_secs: context.options.timestep_secs,
        gravity: context.options.gravity,
        integration: context.options.integration,
        grounds,
        contacts: context.options.contacts.clone(),
        law: Law::Constraints,
        links: links.plans,
        motors,
        tendons,
        equalities,
        connections,
        keyframes,
        bodies: bodies.into_iter().map(|body| body.name).collect(),
        left_out,
    })
}

/// Adds a sentence if MuJoCo would compute contacts between the robot's own shapes.
fn note_contacts(bodies: &[Body], left_out: &mut Vec<String>) {
    let geoms: Vec<(usize, &Geom)> = bodies
        .iter()
        .enumerate()
        .flat_map(|(index, body)| body.geoms.iter().map(move |geom| (index, geom)))
        .collect();
    let meets = |(a, geom): &&(usize, &Geom)| {
        geoms.iter().any(|(b, other)| a != b && geom.surface.meets(&other.surface))
    };
    let count = geoms.iter().filter(meets).count();
    if count > 0 {
        left_out.push(format!("links do not touch each other: contacts between {count} shapes"));
    }
}
