//! Writes a model that names other files as one document without files: included files are part of it, meshes that collide
//! are the corners of their hulls, shapes that are fitted to meshes have their sizes, heights of fields and masses of meshes
//! are stated. All other meshes are left out, and so is what has no effect on the motion.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::sync::Arc;

use super::super::document::Element;
use super::super::folder::Folder;
use super::super::heights;
use super::aligned;
use super::bodies::{self, Body};
use super::context::Context;
use super::geoms::Geom;
use super::meshes::asset_name;
use super::options::MassSource;
use super::replicate;
use crate::scene::{Hull, Shape};

/// Sections without effect on the motion.
const SECTIONS: [&str; 5] = ["size", "statistic", "visual", "custom", "sensor"];
/// Paths of files, which the document does not name any more.
const PATHS: [&str; 4] = ["meshdir", "assetdir", "texturedir", "strippath"];
/// Attributes that a shape which is fitted to a mesh loses.
const FITTED: [&str; 7] = ["mesh", "material", "fitscale", "euler", "axisangle", "xyaxes", "zaxis"];
/// Corners of a mesh that only marks the base of a robot, m.
const MARK: &str = "0 0 0 0.001 0 0 0 0.001 0 0 0 0.001";

/// What remains of a body.
#[derive(Default)]
struct Rest {
    /// Attributes of the mass and inertia to state; `None` if the document states or implies them without meshes.
    inertial: Option<BTreeMap<String, String>>,
    /// Whether an `inertial` of the document counts; not where the shapes decide.
    is_stated: bool,
    /// For each shape of the body, in order.
    shapes: VecDeque<Kept>,
}

/// What remains of a shape.
#[derive(PartialEq)]
enum Kept {
    Whole,
    /// A mesh, which its class may name.
    Mesh(String),
    /// All but these attributes, which replace the mesh that it is fitted to.
    Fitted(Vec<(String, String)>),
    Nothing,
    /// Its existence, with this mesh: a base without any shape would not be a link.
    Mark(Option<String>),
}

/// Corners of the meshes that remain, by name; without a hull for a mark.
type Hulls = BTreeMap<String, Option<Arc<Hull>>>;

/// A document that can be built, as one without other files. The robots of both have the same shapes, masses and joints.
pub(in super::super) fn flat(mjcf: &str, folder: &mut Folder<'_>) -> Result<String, String> {
    let mut root = Element::parse(mjcf, folder)?;
    replicate::expand(&mut root, folder)?;
    let (mut context, _) = Context::read(&root)?;
    let mut hulls = Hulls::new();
    let bodies = bodies::flat(&root, &context);
    let mut rests = Vec::new();
    for (index, body) in bodies.iter().enumerate() {
        let shapes = kept_shapes(body, &mut context, folder, &mut hulls)?;
        // Without a base, the mass of what is fixed to the world matters for `settotalmass` alone.
        let matters = bodies::has_base(&bodies) || context.options.total_mass.is_some();
        let weighs = index > 0 && (!body.is_static || matters);
        let inertial =
            if weighs { inertia((bodies.as_slice(), index), &mut context, folder)? } else { None };
        let is_stated = !matches!(bodies::stated_inertia(body, &context.options), Ok(None));
        rests.push(Rest { inertial, is_stated, shapes });
    }
    mark_base(&bodies, &mut rests, &mut hulls);
    let source = context.options.mass_source;
    root.children.retain(|section| !SECTIONS.contains(&section.tag.as_str()));
    for section in &mut root.children {
        match section.tag.as_str() {
            "compiler" => {
                let keep = |name: &str| !PATHS.contains(&name) && name != "inertiafromgeom";
                let is_source =
                    |name: &str| source != MassSource::Shapes && name == "inertiafromgeom";
                section.attributes.retain(|name, _| keep(name) || is_source(name));
            }
            // A path without its sites is none, and no length has an effect.
            "tendon" => section.children.retain(|child| child.tag != "spatial"),
            "asset" => assets(section, (&context, folder), &hulls)?,
            "default" => without_assets(section),
            _ => {}
        }
    }
    let mut next = 0;
    for world in root.children.iter_mut().filter(|section| section.tag == "worldbody") {
        rewrite(world, 0, &mut next, &mut rests, &context);
    }
    Ok(written(&root))
}

/// What remains of a body's shapes. The corners of meshes that collide are added to `hulls`.
fn kept_shapes(
    body: &Body,
    context: &mut Context,
    folder: &mut Folder<'_>,
    hulls: &mut Hulls,
) -> Result<VecDeque<Kept>, String> {
    let mut shapes = VecDeque::new();
    for geom in &body.geoms {
        if !geom.is_mesh() && geom.element.text("mesh").is_some() {
            shapes.push_back(Kept::Fitted(fitted(geom, context, folder)?));
            continue;
        }
        shapes.push_back(match geom.element.text("mesh").filter(|_| geom.is_mesh()) {
            _ if !geom.is_mesh() => Kept::Whole,
            Some(name) if geom.collides() => {
                let hull = context.meshes.hull(&geom.element, folder)?;
                hulls.insert(name.to_owned(), Some(hull));
                Kept::Mesh(name.to_owned())
            }
            _ => Kept::Nothing,
        });
    }
    Ok(shapes)
}

/// Size and pose of a shape that is fitted to a mesh.
fn fitted(
    geom: &Geom,
    context: &mut Context,
    folder: &mut Folder<'_>,
) -> Result<Vec<(String, String)>, String> {
    let (shape, pose) = geom.shape(&mut context.meshes, folder)?;
    let pose = context.options.angles.frame(&geom.element)?.pose() * geom.inside(&pose);
    let size = match shape {
        Shape::Sphere { radius } => vec![radius],
        Shape::Capsule { radius, half_length } | Shape::Cylinder { radius, half_length } => {
            vec![radius, half_length]
        }
        Shape::Box { half_sizes } | Shape::Ellipsoid { half_sizes } => half_sizes.to_vec(),
        Shape::Hull(_) => return Err(geom.element.refuse("it is fitted to no mesh")),
    };
    let [x, y, z, w] = pose.rotation.to_array();
    let position = pose.translation.to_array();
    let attributes = [("size", &*size), ("pos", &position), ("quat", &[w, x, y, z])];
    Ok(attributes.map(|(name, numbers)| (name.to_owned(), text(numbers))).into())
}

fn text<T: ToString>(numbers: &[T]) -> String {
    numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
}

/// Mass and inertia of a body to which meshes contribute.
fn inertia(
    (bodies, index): (&[Body], usize),
    context: &mut Context,
    folder: &mut Folder<'_>,
) -> Result<Option<BTreeMap<String, String>>, String> {
    let body = &bodies[index];
    let is_stated = bodies::stated_inertia(body, &context.options)?.is_some();
    if is_stated || !body.geoms.iter().any(|geom| geom.is_mesh() && geom.weighs()) {
        return Ok(None);
    }
    let solid = bodies::solid(body, context, folder)?;
    let (centre, moments) = if aligned::is_aligned(bodies, index, context) {
        // The axes of `fullinertia` would have other directions.
        let frame = aligned::inertial_frame(body, context, folder)?;
        let inside = solid.turned(frame.inverse().rotation).inertia;
        let principal = [0, 1, 2].map(|axis| inside[axis][axis].max(0.0));
        let [x, y, z, w] = frame.rotation;
        let moments = vec![("quat", text(&[w, x, y, z])), ("diaginertia", text(&principal))];
        (frame.position, moments)
    } else {
        let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = solid.inertia;
        (solid.centre, vec![("fullinertia", text(&[xx, yy, zz, xy, xz, yz]))])
    };
    let place = [("pos", text(&centre)), ("mass", text(&[solid.mass]))];
    let attributes = place.into_iter().chain(moments);
    Ok(Some(attributes.map(|(name, text)| (name.to_owned(), text)).collect()))
}

/// Keeps a shape of the first body that is fixed to the world and has shapes: the base has its name.
fn mark_base(bodies: &[Body], rests: &mut [Rest], hulls: &mut Hulls) {
    let shaped = |body: &&Body| body.is_static && body.geoms.iter().any(|geom| !geom.is_ground());
    let Some(index) = bodies.iter().skip(1).position(|body| shaped(&body)) else { return };
    let (body, rest) = (&bodies[index + 1], &mut rests[index + 1]);
    let grounds = body.geoms.iter().map(Geom::is_ground);
    let stays = |(kept, is_ground): (&Kept, bool)| *kept != Kept::Nothing && !is_ground;
    if !bodies::has_base(bodies) || rest.shapes.iter().zip(grounds).any(stays) {
        return;
    }
    let first = rest.shapes.iter().position(|kept| *kept == Kept::Nothing);
    let Some(first) = first else { return };
    let mesh = body.geoms[first].element.text("mesh").map(str::to_owned);
    rest.shapes[first] = Kept::Mark(mesh.clone());
    if let Some(name) = mesh {
        hulls.entry(name).or_insert(None);
    }
}

/// Leaves the meshes that shapes need, as lists of corners.
fn assets(
    section: &mut Element,
    (context, folder): (&Context, &mut Folder<'_>),
    hulls: &Hulls,
) -> Result<(), String> {
    for mut asset in std::mem::take(&mut section.children) {
        let name = match asset.tag.as_str() {
            "mesh" => asset_name(&context.classes.resolve(&asset, None)?),
            "hfield" => {
                if let Some((path, bytes)) = context.meshes.files.read(&asset, folder)? {
                    state_heights(&mut asset, &path, &bytes)?;
                }
                section.children.push(asset);
                continue;
            }
            _ => continue,
        };
        if let Some(hull) = hulls.get(&name) {
            let vertex = hull.as_ref().map_or_else(|| MARK.to_owned(), |hull| corners(hull));
            // It has no effect, which is reported.
            let most =
                context.classes.resolve(&asset, None)?.text("maxhullvert").map(str::to_owned);
            let attributes = [("name", name), ("vertex", vertex)].into_iter();
            let attributes = attributes.chain(most.map(|most| ("maxhullvert", most)));
            asset.attributes = attributes.map(|(name, text)| (name.to_owned(), text)).collect();
            section.children.push(asset);
        }
    }
    Ok(())
}

/// Replaces the file of a height field by its heights.
fn state_heights(asset: &mut Element, path: &str, bytes: &[u8]) -> Result<(), String> {
    let read = heights::read(path, asset.text("content_type"), bytes);
    let (columns, heights) = read.map_err(|reason| asset.refuse(reason))?;
    let heights: Vec<f32> = heights.into_iter().map(|height| height as f32).collect();
    let attributes = [
        ("name", asset_name(asset)),
        ("nrow", (heights.len() / columns).to_string()),
        ("ncol", columns.to_string()),
        ("elevation", text(&heights)),
    ];
    asset.attributes.retain(|name, _| name == "size");
    asset.attributes.extend(attributes.map(|(name, text)| (name.to_owned(), text)));
    Ok(())
}

fn corners(hull: &Hull) -> String {
    text(hull.points.as_flattened())
}

/// Removes the defaults of meshes, which have their final coordinates, of materials, and of the meshes of shapes, which the
/// shapes themselves name.
fn without_assets(default: &mut Element) {
    default.children.retain(|child| !["mesh", "material"].contains(&child.tag.as_str()));
    for child in &mut default.children {
        child
            .attributes
            .retain(|name, _| !["material", "mesh", "fitscale"].contains(&name.as_str()));
        if child.tag == "default" {
            without_assets(child);
        }
    }
}

/// Rewrites the children of a body, or of a frame in it. `next` counts the bodies in the order of the document.
fn rewrite(
    element: &mut Element,
    own: usize,
    next: &mut usize,
    rests: &mut [Rest],
    context: &Context,
) {
    let is_used = |name: &str| context.sites.contains(name);
    for mut child in std::mem::take(&mut element.children) {
        match child.tag.as_str() {
            "camera" | "light" => continue,
            "site" if !child.text("name").is_some_and(is_used) => continue,
            "site" => drop(child.attributes.remove("material")),
            "inertial" if !rests[own].is_stated => continue,
            "geom" => match rests[own].shapes.pop_front() {
                Some(Kept::Nothing) | None => continue,
                Some(Kept::Whole) => drop(child.attributes.remove("material")),
                Some(Kept::Fitted(attributes)) => {
                    child.attributes.retain(|name, _| !FITTED.contains(&name.as_str()));
                    child.attributes.extend(attributes);
                }
                Some(Kept::Mesh(mesh)) => {
                    child.attributes.remove("material");
                    child.attributes.insert("mesh".to_owned(), mesh);
                }
                Some(Kept::Mark(mesh)) => {
                    child.attributes.extend(mesh.map(|mesh| ("mesh".to_owned(), mesh)));
                    let seen = [("contype", "0"), ("conaffinity", "0"), ("mass", "0")];
                    child.attributes.remove("material");
                    child.attributes.extend(seen.map(|(k, v)| (k.to_owned(), v.to_owned())));
                }
            },
            "frame" => rewrite(&mut child, own, next, rests, context),
            "body" => {
                *next += 1;
                let index = *next;
                rewrite(&mut child, index, next, rests, context);
                if let Some(attributes) = rests[index].inertial.take() {
                    let mut inertial = child.with(attributes);
                    "inertial".clone_into(&mut inertial.tag);
                    child.children.insert(0, inertial);
                }
            }
            _ => {}
        }
        element.children.push(child);
    }
}

/// The text of an element.
fn written(root: &Element) -> String {
    let mut text = String::new();
    write_element(root, 0, &mut text);
    text
}

fn write_element(element: &Element, depth: usize, text: &mut String) {
    let indent = "  ".repeat(depth);
    let _ = write!(text, "{indent}<{}", element.tag);
    for (name, value) in &element.attributes {
        let _ = write!(text, " {name}=\"{}\"", escaped(value));
    }
    if element.children.is_empty() {
        text.push_str("/>\n");
        return;
    }
    text.push_str(">\n");
    element.children.iter().for_each(|child| write_element(child, depth + 1, text));
    let _ = writeln!(text, "{indent}</{}>", element.tag);
}

fn escaped(value: &str) -> String {
    value.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
