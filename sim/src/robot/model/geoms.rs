//! Shapes of bodies: form, mass, and contacts with the floor.

mod weight;

use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::prelude::SharedShape;

use super::super::blueprint::{GroundForm, GroundPlan};
use super::super::document::{Element, ORIENTATIONS, bounds};
use super::super::folder::Folder;
use super::super::frame::{Frame, vector};
use super::super::inertia::Solid;
use super::super::surface::Surface;
use super::context::Context;
use super::fields;
use super::meshes::Meshes;
use crate::scene::Shape;

const KNOWN: [&str; 20] = [
    "name",
    "class",
    "type",
    "size",
    "pos",
    "fromto",
    "mass",
    "density",
    "mesh",
    "fitscale",
    "hfield",
    "shellinertia",
    "fluidshape",
    // Without effect on the motion of most shapes.
    "fluidcoef",
    "castshadow",
    "gap",
    "group",
    "material",
    "rgba",
    "user",
];
/// Types with a size, all but the first also between two points.
const SOLIDS: [&str; 5] = ["sphere", "capsule", "cylinder", "box", "ellipsoid"];
/// Types whose size other elements state.
const UNSIZED: [&str; 2] = ["mesh", "hfield"];
/// Density of shapes that state neither density nor mass, kg/m^3.
const WATER: f64 = 1000.0;

/// A shape of a body, with the attributes of its class.
pub(super) struct Geom {
    pub(super) element: Element,
    /// Frame of the shape in its body, without the shape's own length.
    frame: Frame,
    /// Frame in the body in which the shape is stated.
    outer: Frame,
    /// Ends of the shape in that frame, if it states them.
    ends: Option<[[f64; 3]; 2]>,
    pub(super) surface: Surface,
    /// Whether a contact pair names it.
    is_paired: bool,
    /// Whether its group has masses.
    is_heavy: bool,
    /// Whether its surface has its mass.
    is_shell: bool,
}

impl Geom {
    /// Reads a shape that is stated in `outer`, a frame in its body.
    pub(super) fn new(element: Element, outer: Frame, context: &Context) -> Result<Self, String> {
        let known = [&KNOWN[..], &ORIENTATIONS, &Surface::ATTRIBUTES];
        context.blockers.keep(element.only(&known));
        let surface = Surface::read(&element)?;
        let [first, last] = context.options.mass_groups;
        let geom = Self {
            frame: outer.then(&context.options.angles.frame(&element)?),
            outer,
            ends: ends(&element)?,
            surface,
            is_paired: element.text("name").is_some_and(|name| context.paired.contains(name)),
            is_heavy: (first..=last).contains(&element.integer("group", 0)?),
            is_shell: element.flag("shellinertia")? == Some(true),
            element,
        };
        geom.check()?;
        Ok(geom)
    }

    /// Refuses a type or size that MuJoCo refuses, also of a shape that is used no further since nothing can touch it.
    fn check(&self) -> Result<(), String> {
        let element = &self.element;
        let size = element.text("size").unwrap_or_default();
        let is_finite = |number: &str| number.parse::<f64>().is_ok_and(f64::is_finite);
        if !size.split_ascii_whitespace().all(is_finite) {
            element.list("size")?;
        }
        let is_positive = |number: &str| number.parse::<f64>().is_ok_and(|number| number > 0.0);
        if self.is_shell && self.is_mesh() {
            let reason =
                "a mesh has no `shellinertia`; remove it, and set inertia=\"shell\" in its asset";
            return Err(element.refuse_for("shellinertia", reason));
        }
        match self.kind() {
            "plane" => {
                let size: Vec<&str> = size.split_ascii_whitespace().collect();
                if size.len() == 3 && is_positive(size[2]) {
                    return Ok(());
                }
                let reason = "a plane's `size` must have three numbers, the third positive; set it, such as 0 0 1";
                Err(element.refuse_for("size", reason))
            }
            kind if UNSIZED.contains(&kind) => Ok(()),
            kind if !SOLIDS.contains(&kind) => {
                let reason = format!("the type `{kind}` is not supported; use a box or a mesh");
                Err(element.refuse_for("type", reason))
            }
            _ if element.text("mesh").is_some() => Ok(()),
            _ => {
                let needed = self.needed();
                let numbers = size.split_ascii_whitespace().take(needed);
                if numbers.filter(|number| is_positive(number)).count() < needed {
                    let reason = format!("`size` must have {needed} positive numbers");
                    return Err(element.refuse_for("size", reason));
                }
                self.ends.map_or(Ok(()), |ends| self.pose_between(ends).map(drop))
            }
        }
    }

    /// Half the distance of two points, m, and the pose in their middle, in the frame in which they are stated.
    fn pose_between(&self, ends: [[f64; 3]; 2]) -> Result<(f32, Pose), String> {
        let same = "`fromto` names the same point twice; set two different ones";
        between(ends).ok_or_else(|| self.element.refuse_for("fromto", same))
    }

    /// Numbers of `size` that the shape needs.
    fn needed(&self) -> usize {
        match self.kind() {
            _ if self.ends.is_some() => 1,
            "sphere" => 1,
            "capsule" | "cylinder" => 2,
            _ => 3,
        }
    }

    /// Its name, or nothing.
    pub(super) fn name(&self) -> String {
        self.element.text("name").unwrap_or_default().to_owned()
    }

    /// Whether the shape can touch anything.
    pub(super) fn collides(&self) -> bool {
        self.is_paired || self.surface.collides()
    }

    /// Whether the shape can touch another one of these.
    pub(super) fn meets(&self, others: &[Surface]) -> bool {
        self.is_paired || others.iter().any(|other| self.surface.meets(other))
    }

    pub(super) fn is_mesh(&self) -> bool {
        self.kind() == "mesh"
    }

    /// Whether MuJoCo's other model of a fluid applies to its body.
    pub(super) fn is_ellipsoid_in_fluid(&self) -> bool {
        self.element.text("fluidshape") == Some("ellipsoid")
    }

    pub(super) fn is_plane(&self) -> bool {
        self.kind() == "plane"
    }

    pub(super) fn is_field(&self) -> bool {
        self.kind() == "hfield"
    }

    /// Whether it must be fixed to the world: a plane or a height field.
    pub(super) fn is_ground(&self) -> bool {
        self.is_plane() || self.is_field()
    }

    fn kind(&self) -> &str {
        kind(&self.element)
    }

    /// Whether the shape has a mass.
    pub(super) fn weighs(&self) -> bool {
        let mass = self.element.text("mass").or(self.element.text("density"));
        self.is_heavy && mass.and_then(|mass| mass.trim().parse::<f64>().ok()) != Some(0.0)
    }

    /// Form of the shape, and its pose in its body.
    pub(super) fn shape(
        &self,
        meshes: &mut Meshes,
        folder: &mut Folder<'_>,
    ) -> Result<(Shape, Pose), String> {
        if self.is_mesh() {
            Ok((Shape::Hull(meshes.hull(&self.element, folder)?), self.frame.pose()))
        } else if SOLIDS.contains(&self.kind()) && self.element.text("mesh").is_some() {
            self.fitted(meshes, folder)
        } else {
            self.primitive()
        }
    }

    /// A shape that needs no mesh.
    fn primitive(&self) -> Result<(Shape, Pose), String> {
        let element = &self.element;
        let is_long = matches!(self.kind(), "capsule" | "cylinder");
        let size = element.list("size")?.unwrap_or_default();
        if size.len() > 3 {
            return Err(element.refuse_for("size", "`size` must have at most 3 numbers"));
        }
        let size: Vec<f32> = size.iter().map(|length| *length as f32).collect();
        let Some(ends) = self.ends else {
            return Ok((form(self.kind(), &size), self.frame.pose()));
        };
        // The direction matters for a box, whose other two axes turn with it.
        let ends = if is_long { ends } else { [ends[1], ends[0]] };
        let (half_length, pose) = self.pose_between(ends)?;
        let size =
            if is_long { vec![size[0], half_length] } else { vec![size[0], size[0], half_length] };
        Ok((form(self.kind(), &size), self.outer.pose() * pose))
    }

    /// A primitive form in place of a mesh, with the inertia of the same box as the mesh, and its pose in its body.
    fn fitted(
        &self,
        meshes: &mut Meshes,
        folder: &mut Folder<'_>,
    ) -> Result<(Shape, Pose), String> {
        let element = &self.element;
        let hull = meshes.hull(element, folder)?;
        let (centre, [x, y, z], axes) = meshes.solid(element, &hull)?.half_box();
        let size = match self.kind() {
            "sphere" => [(x + y + z) / 3.0, 0.0, 0.0],
            "capsule" => [(x + y) / 2.0, (z - (x + y) / 4.0).max(0.0), 0.0],
            "cylinder" => [(x + y) / 2.0, z, 0.0],
            _ => [x, y, z],
        };
        let scale = element.number("fitscale", 1.0)?;
        let size = size.map(|length| (scale * length) as f32);
        let fits = |length: &f32| bounds::refusal("size", f64::from(*length)).is_none();
        if !(size[0] > 0.0 && size.iter().all(fits)) {
            return Err(
                element.refuse("its mesh is flat or its `fitscale` too large; state its `size`")
            );
        }
        let inside = Pose::from_parts(vector(centre), axes);
        Ok((form(self.kind(), &size), self.frame.pose() * inside))
    }

    /// MuJoCo's axes of the shape in its body; those of shapes with ends turn about the line between them.
    pub(super) fn axes(&self, pose: &Pose) -> Rotation {
        let turned = self.ends.and_then(|[from, to]| between([to, from]));
        turned.map_or(*pose, |(_, turned)| self.outer.pose() * turned).rotation
    }

    /// Frame of its inertia in its body, with the axes that MuJoCo finds.
    pub(super) fn inertial_frame(
        &self,
        meshes: &mut Meshes,
        folder: &mut Folder<'_>,
    ) -> Result<Frame, String> {
        if self.element.text("mesh").is_some() {
            let hull = meshes.hull(&self.element, folder)?;
            let solid = meshes.solid(&self.element, &hull)?;
            let inside = Frame { position: solid.centre, rotation: solid.sorted_axes() };
            return Ok(self.frame.then(&inside));
        }
        let between = self.ends.and_then(Frame::between);
        Ok(between.map_or(self.frame, |inside| self.outer.then(&inside)))
    }

    /// The frame of the shape as one in `outer`, a frame in its body.
    pub(super) fn seen_from(&mut self, outer: &Frame) {
        let inverse = outer.inverse();
        self.frame = inverse.then(&self.frame);
        self.outer = inverse.then(&self.outer);
    }

    /// A pose in the shape's body as one in the shape's stated frame.
    pub(super) fn inside(&self, pose: &Pose) -> Pose {
        self.frame.pose().inv_mul(pose)
    }

    /// Mass, mass centre and inertia of the shape in its link's frame.
    pub(super) fn solid(
        &self,
        shape: &Shape,
        pose: &Pose,
        meshes: &Meshes,
    ) -> Result<Solid, String> {
        let mass = self.element.numbers::<1>("mass")?.map(|[mass]| mass);
        let density = match self.element.number("density", WATER)? {
            // A stated mass has the distribution of any density.
            0.0 if mass.is_some() => WATER,
            density => density,
        };
        let solid = match *shape {
            _ if self.is_shell => {
                let (area, moments) = weight::shell(shape);
                let mass = density * area;
                Solid::principal(mass, moments.map(|moment| mass * moment)).placed(pose)
            }
            Shape::Sphere { radius } => {
                Solid::of_shape(&SharedShape::ball(radius), density as f32, pose)
            }
            Shape::Capsule { half_length, radius } => {
                let shape = SharedShape::capsule_z(half_length, radius);
                Solid::of_shape(&shape, density as f32, pose)
            }
            Shape::Hull(ref hull) => {
                let solid = meshes.solid(&self.element, hull)?;
                solid.with_mass(density * solid.mass).placed(pose)
            }
            ref shape => {
                let (volume, squares) = weight::volume(shape);
                let mass = density * volume;
                let [x, y, z] = squares.map(|square| mass * square);
                Solid::principal(mass, [y + z, z + x, x + y]).placed(pose)
            }
        };
        Ok(mass.map_or(solid, |mass| solid.with_mass(mass)))
    }

    /// The shape as one that is fixed to the world. `frame` is the frame of its body in the world, `body` the body's
    /// index.
    pub(super) fn ground(
        &self,
        (frame, body): (&Frame, usize),
        context: &mut Context,
        folder: &mut Folder<'_>,
    ) -> Result<GroundPlan, String> {
        let placed = frame.then(&self.frame).pose();
        let (form, pose) = match self.kind() {
            "plane" => (GroundForm::Plane, placed),
            "hfield" => {
                let sources = (&context.fields, &context.meshes.files);
                (GroundForm::Field(fields::field(&self.element, sources, folder)?), placed)
            }
            _ => {
                let (shape, pose) = self.shape(&mut context.meshes, folder)?;
                (GroundForm::Solid(shape), frame.pose() * pose)
            }
        };
        Ok(GroundPlan { name: self.name(), form, pose, surface: self.surface, body })
    }
}

fn kind(element: &Element) -> &str {
    element.text("type").unwrap_or("sphere")
}

/// The two points of `fromto`. As in MuJoCo, a shape with them has no other position, and only some forms have them.
pub(super) fn ends(element: &Element) -> Result<Option<[[f64; 3]; 2]>, String> {
    let Some([a, b, c, d, e, f]) = element.numbers::<6>("fromto")? else { return Ok(None) };
    let kind = kind(element);
    if !SOLIDS[1..].contains(&kind) {
        let reason = format!("a shape of the type `{kind}` has no `fromto`; remove it");
        return Err(element.refuse_for("fromto", reason));
    }
    if element.text("mesh").is_some() {
        let reason = "a shape with a `mesh` has no `fromto`; remove it";
        return Err(element.refuse_for("fromto", reason));
    }
    if element.numbers::<3>("pos")?.is_some_and(|position| position != [0.0; 3]) {
        return Err(element.refuse_for("pos", "it has both `pos` and `fromto`; remove one"));
    }
    Ok(Some([[a, b, c], [d, e, f]]))
}

/// A primitive shape; `size` has as many numbers as the kind needs.
fn form(kind: &str, size: &[f32]) -> Shape {
    match kind {
        "sphere" => Shape::Sphere { radius: size[0] },
        "capsule" => Shape::Capsule { radius: size[0], half_length: size[1] },
        "cylinder" => Shape::Cylinder { radius: size[0], half_length: size[1] },
        "box" => Shape::Box { half_sizes: [size[0], size[1], size[2]] },
        _ => Shape::Ellipsoid { half_sizes: [size[0], size[1], size[2]] },
    }
}

/// Half the distance of two points, and the pose at their middle with the z axis from the first to the second.
fn between([from, to]: [[f64; 3]; 2]) -> Option<(f32, Pose)> {
    let (a, b) = (vector(from), vector(to));
    let turn = Rotation::from_rotation_arc(Vector::Z, (b - a).try_normalize()?);
    Some(((b - a).length() / 2.0, Pose::from_parts((a + b) / 2.0, turn)))
}
