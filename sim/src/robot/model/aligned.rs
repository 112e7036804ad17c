//! Free bodies whose frames MuJoCo moves to those of their inertia, so that the mass centre is the origin.

use super::super::folder::Folder;
use super::super::frame::Frame;
use super::bodies::{self, Body};
use super::context::Context;
use super::joints;

/// Moves the frames of all bodies of which the document says so.
pub(super) fn align(bodies: &mut [Body], context: &mut Context, folder: &mut Folder<'_>) {
    for index in 1..bodies.len() {
        if !bodies[index].is_whole || !is_aligned(bodies, index, context) {
            continue;
        }
        let frame = inertial_frame(&bodies[index], context, folder);
        match context.blockers.keep(frame) {
            Some(frame) => bodies[index].move_frame(&frame),
            None => bodies[index].is_whole = false,
        }
    }
}

/// Whether the frame of a body is that of its inertia. As in MuJoCo, a body with children keeps its own.
pub(super) fn is_aligned(bodies: &[Body], index: usize, context: &Context) -> bool {
    let [joint] = bodies[index].joints.as_slice() else { return false };
    let stated = joint.0.flag("align").ok().flatten();
    joints::is_free(joint)
        && stated.unwrap_or(context.options.aligns_free)
        && bodies.iter().skip(1).all(|other| other.parent != index)
}

/// Frame of a body's inertia in its own frame, with the axes that MuJoCo finds.
pub(super) fn inertial_frame(
    body: &Body,
    context: &mut Context,
    folder: &mut Folder<'_>,
) -> Result<Frame, String> {
    let is_stated = bodies::stated_inertia(body, &context.options)?.is_some();
    let stated = bodies::stated_frame(body, &context.options);
    if let Some(frame) = stated.filter(|_| is_stated && body.states_moments()) {
        return Ok(frame);
    }
    let mut heavy = body.geoms.iter().filter(|geom| geom.weighs() && !geom.is_ground());
    if !is_stated && let (Some(only), None) = (heavy.next(), heavy.next()) {
        return only.inertial_frame(&mut context.meshes, folder);
    }
    let solid = bodies::solid(body, context, folder)?;
    if solid.mass <= 0.0 {
        let reason = "its frame would be that of its inertia, but it has no mass; state its `inertial`, or set align=\"false\"";
        return Err(body.element.refuse(reason));
    }
    Ok(Frame { position: solid.centre, rotation: solid.sorted_axes() })
}
