//! Reads a robot's blueprint from an MJCF document. Unsupported elements are errors, never ignored.

use mjcf_rs::Model;
use mjcf_rs::body::{Body, Geom, GeomType, Joint, JointType};
use mjcf_rs::extras::{Actuator, ActuatorKind};
use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::MassProperties;

use super::blueprint::{
    Blueprint, Floor, Hinge, HingeAxis, JointPlan, LinkPlan, MotorPlan, Planar, ShapePlan,
};
use super::inertia::MassSum;
use crate::scene::Shape;

/// Reads an MJCF document. Errors name the element.
pub(super) fn read(mjcf: &str) -> Result<Blueprint, String> {
    let model = Model::from_str(mjcf, ".").map_err(|error| error.to_string())?;
    let links = read_links(&model)?;
    Ok(Blueprint {
        timestep_secs: model.option.timestep,
        gravity: vector(model.option.gravity),
        floor: read_floor(&model.bodies[0].body)?,
        links,
        motors: model.actuators.iter().map(read_motor).collect::<Result<_, _>>()?,
        bodies: std::iter::once("world".to_owned())
            .chain(model.bodies_iter().map(|(_, entry)| name(&entry.body)))
            .collect(),
    })
}

fn read_links(model: &Model) -> Result<Vec<LinkPlan>, String> {
    let mut links: Vec<LinkPlan> = Vec::new();
    let mut masses: Vec<MassSum> = Vec::new();
    // Link of each body, and the body's frame in that link.
    let mut homes: Vec<Option<(usize, Pose)>> = vec![None; model.bodies.len()];
    for (id, entry) in model.bodies_iter() {
        let parent = entry.parent.and_then(|parent| homes[parent]);
        let inside = parent.map_or(Pose::IDENTITY, |(_, frame)| frame) * pose(&entry.body.pose);
        let home = match (parent, entry.body.joints.is_empty()) {
            (None, true) => return Err(format!("{}: the root needs a joint", name(&entry.body))),
            (Some((link, _)), true) => (link, inside),
            (_, false) => {
                links.push(read_link(model, &entry.body, parent.map(|(link, _)| link), inside)?);
                masses.push(MassSum::default());
                (links.len() - 1, Pose::IDENTITY)
            }
        };
        add_shapes(model, (&entry.body, id), (&mut links[home.0], &mut masses[home.0]), &home.1)?;
        homes[id] = Some(home);
    }
    set_masses(&mut links, &masses, model.compiler.set_total_mass);
    match links.iter().filter(|link| link.parent.is_none()).count() {
        1 => Ok(links),
        roots => Err(format!("a robot must have one root; found {roots}")),
    }
}

fn read_link(
    model: &Model,
    body: &Body,
    parent: Option<usize>,
    rest: Pose,
) -> Result<LinkPlan, String> {
    if body.inertial.is_some() {
        return Err(format!("{}: masses must come from shapes, not from <inertial>", name(body)));
    }
    let joint = match (parent, body.joints.as_slice()) {
        (None, [free]) if free.type_ == JointType::Free => JointPlan::Free(joint_name(free)),
        (None, [x, z, turn]) => JointPlan::Planar(read_planar([x, z, turn])?),
        (Some(_), [hinge]) => JointPlan::Hinge(read_hinge(model, hinge)?),
        (_, joints) => {
            return Err(format!(
                "{}: unsupported combination of {} joints",
                name(body),
                joints.len()
            ));
        }
    };
    let mass = MassProperties::default();
    Ok(LinkPlan { name: name(body), parent, rest, joint, mass, shapes: Vec::new() })
}

fn read_planar(joints: [&Joint; 3]) -> Result<Planar, String> {
    let kinds = [JointType::Slide, JointType::Slide, JointType::Hinge];
    let axes = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]];
    for ((joint, kind), axis) in joints.into_iter().zip(kinds).zip(axes) {
        let passive = [joint.stiffness, joint.damping, joint.armature, joint.frictionloss];
        if joint.type_ != kind || joint.axis != axis || joint.pos != [0.0; 3] {
            let joint = joint_name(joint);
            return Err(format!(
                "{joint}: a planar root must slide along x and z and rotate about +y"
            ));
        }
        if passive != [0.0; 4] {
            return Err(format!(
                "{}: a planar root must not have passive terms",
                joint_name(joint)
            ));
        }
    }
    Ok(Planar { names: joints.map(joint_name), reference: joints.map(|joint| joint.ref_ as f32) })
}

fn read_hinge(model: &Model, joint: &Joint) -> Result<Hinge, String> {
    if joint.type_ != JointType::Hinge || joint.frictionloss != 0.0 || joint.ref_ != 0.0 {
        let joint = joint_name(joint);
        return Err(format!(
            "{joint}: links below the root must have hinges without friction or ref"
        ));
    }
    let limited = joint.limited.resolve(model.compiler.autolimits, joint.range.is_some());
    Ok(Hinge {
        name: joint_name(joint),
        anchor: vector(joint.pos),
        axis: HingeAxis::along(vector(joint.axis)),
        range: joint.range.filter(|_| limited).map(|range| range.map(|end| end as f32)),
        stiffness: joint.stiffness as f32,
        spring_rest: joint.springref as f32,
        damping: joint.damping as f32,
        armature: joint.armature as f32,
    })
}

fn add_shapes(
    model: &Model,
    (body, index): (&Body, usize),
    (link, mass): (&mut LinkPlan, &mut MassSum),
    frame: &Pose,
) -> Result<(), String> {
    for geom in &body.geoms {
        if geom.contype != 0 && geom.conaffinity != 0 {
            return Err(format!(
                "{}: links collide only with the floor; set contype or conaffinity to 0",
                name(body)
            ));
        }
        let (shape, inside) = read_shape(geom).ok_or_else(|| unsupported(body, geom))?;
        let pose = *frame * inside;
        let density = geom.density.unwrap_or(model.compiler.inertia_density) as f32;
        mass.add(&shape.collider(), density, &pose);
        let friction = geom.friction[0] as f32;
        link.shapes.push(ShapePlan { shape, pose, friction, body: index });
    }
    Ok(())
}

fn read_shape(geom: &Geom) -> Option<(Shape, Pose)> {
    let radius = geom.size[0] as f32;
    match (geom.type_, geom.fromto, geom.mass) {
        (GeomType::Sphere, None, None) => Some((Shape::Sphere { radius }, pose(&geom.pose))),
        (GeomType::Capsule, None, None) => {
            let half_length = geom.size[1] as f32;
            Some((Shape::Capsule { half_length, radius }, pose(&geom.pose)))
        }
        (GeomType::Capsule, Some([ax, ay, az, bx, by, bz]), None) => {
            let (a, b) = (vector([ax, ay, az]), vector([bx, by, bz]));
            let turn = Rotation::from_rotation_arc(Vector::Z, (b - a).normalize());
            let half_length = (b - a).length() / 2.0;
            let middle = Pose::from_parts((a + b) / 2.0, turn);
            Some((Shape::Capsule { half_length, radius }, middle))
        }
        _ => None,
    }
}

fn read_floor(world: &Body) -> Result<Floor, String> {
    match world.geoms.as_slice() {
        [plane] if plane.type_ == GeomType::Plane => {
            Ok(Floor { pose: pose(&plane.pose), friction: plane.friction[0] as f32 })
        }
        geoms => Err(format!("the world must have one plane; found {} shapes", geoms.len())),
    }
}

fn read_motor(actuator: &Actuator) -> Result<MotorPlan, String> {
    match (&actuator.joint, actuator.kind, actuator.ctrl_range) {
        (Some(joint), ActuatorKind::Motor, Some(range)) => Ok(MotorPlan {
            joint: joint.clone(),
            gear: actuator.gear[0] as f32,
            range: range.map(|end| end as f32),
        }),
        _ => Err(format!("{:?}: only joint motors with a ctrlrange are supported", actuator.name)),
    }
}

/// Sets the links' mass properties. `settotalmass` scales all masses and inertias to this total; -1 does not scale.
fn set_masses(links: &mut [LinkPlan], masses: &[MassSum], target: f64) {
    let total: f64 = masses.iter().map(MassSum::mass).sum();
    let factor = if target > 0.0 { target / total } else { 1.0 };
    for (link, mass) in links.iter_mut().zip(masses) {
        link.mass = mass.properties(factor);
    }
}

fn unsupported(body: &Body, geom: &Geom) -> String {
    let geom = geom.name.as_deref().unwrap_or("unnamed");
    format!("{}: {geom} is not a sphere or capsule with a density", name(body))
}

fn name(body: &Body) -> String {
    body.name.clone().unwrap_or_else(|| "unnamed body".to_owned())
}

fn joint_name(joint: &Joint) -> String {
    joint.name.clone().unwrap_or_else(|| "unnamed joint".to_owned())
}

fn pose(pose: &mjcf_rs::Pose) -> Pose {
    let [x, y, z, w] = pose.rotation.to_array();
    let rotation = Rotation::from_xyzw(x as f32, y as f32, z as f32, w as f32);
    Pose::from_parts(vector(pose.translation.to_array()), rotation)
}

fn vector([x, y, z]: [f64; 3]) -> Vector {
    Vector::new(x as f32, y as f32, z as f32)
}
