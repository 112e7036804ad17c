//! Reads a robot's blueprint from an MJCF document. Elements without a physical meaning are skipped; all others that
//! cannot be built are errors with their line.

mod actuators;
mod aligned;
mod blockers;
mod bodies;
mod contacts;
mod context;
mod couplings;
mod fields;
mod flat;
mod geoms;
mod joints;
mod keyframes;
mod links;
mod meshes;
mod options;
mod replicate;

use super::blueprint::{Blueprint, Law, MotorPlan};
use super::document::Element;
use super::fluid::Fluid;
use super::folder::Folder;
use super::softness::ImplicitForces;
use context::Context;
pub(super) use flat::flat;
use geoms::Geom;

/// Reads an MJCF document and the files of `folder` that it needs.
pub(super) fn read(mjcf: &str, folder: &mut Folder<'_>) -> Result<Blueprint, String> {
    let mut root = Element::parse(mjcf, folder)?;
    replicate::expand(&mut root, folder)?;
    let (mut context, mut left_out) = Context::read(&root)?;
    for model in root.all("asset").flat_map(|section| section.all("model")) {
        let read = model.text("file").map(|name| folder.read_document(name, model.file()));
        let read = read.unwrap_or_else(|| Err("it has no `file`; add one".to_owned()));
        context.blockers.keep(read.map_err(|reason| model.refuse(reason)));
    }
    let mut bodies = bodies::flat(&root, &context);
    aligned::align(&mut bodies, &mut context, folder);
    let fixed_mass = bodies::fixed_mass(&bodies, &mut context, folder);
    let grounds = bodies::take_grounds(&mut bodies, &mut context, folder);
    let mut links = links::read(&bodies, &mut context, folder);
    links.masses_to_links(&context, fixed_mass);
    let tendons = couplings::tendons(&root, &context, &links.plans);
    let equalities = couplings::equalities(&root, &context, &links.plans, &tendons);
    let connections = couplings::connections(&root, &context, &bodies, &links);
    let motors = actuators::read(&root, &context, (&bodies, &links, &tendons));
    let keyframes = keyframes::read(&root, &context.blockers);
    let contacts = contacts::read(&root, &context, &bodies, (&links.plans, &grounds));
    context.blockers.finish()?;
    left_out.extend(differences(&context, &motors));
    left_out.extend(keyframes::left_out(&root));
    let fluid = Some(context.options.fluid).filter(Fluid::acts);
    if fluid.is_some()
        && bodies.iter().flat_map(|body| &body.geoms).any(Geom::is_ellipsoid_in_fluid)
    {
        left_out.push("no fluid acts on bodies with `fluidshape=\"ellipsoid\"`".to_owned());
    }
    Ok(Blueprint {
        timestep_secs: context.options.timestep_secs,
        gravity: context.options.gravity,
        integration: context.options.integration,
        implicit: context.options.implicit,
        fluid,
        grounds,
        contacts,
        law: Law::Constraints,
        links: links.plans,
        homes: links.homes,
        motors,
        tendons,
        equalities,
        connections,
        keyframes,
        tops: bodies::tops(&bodies),
        bodies: bodies.into_iter().map(|body| body.name).collect(),
        left_out,
    })
}

/// What MuJoCo computes otherwise of meshes, fluids and the speed terms of actuators.
fn differences(context: &Context, motors: &[MotorPlan]) -> Vec<String> {
    let mut found = Vec::new();
    let count = context.meshes.beyond_limit();
    if count > 0 {
        found.push(format!("`maxhullvert` has no effect: {count} hulls have more corners"));
    }
    let implicit = context.options.implicit;
    let has_speed_term = |motor: &MotorPlan| motor.servo.is_some_and(|own| own.bias[2] != 0.0);
    let damped = motors.iter().filter(|motor| has_speed_term(motor));
    let count = damped.filter(|motor| motor.moved.only_hinge().is_some()).count();
    if implicit == ImplicitForces::Damping && count > 0 {
        let what = "the speed terms of servos are implicit, as with integrator=\"implicitfast\"";
        found.push(format!("{what}: {count} actuators"));
    }
    if implicit == ImplicitForces::All && context.options.fluid.acts() {
        found.push("the forces of the fluid are explicit, as with integrator=\"Euler\"".to_owned());
    }
    found
}
