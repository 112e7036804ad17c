//! Settings of a document: `compiler` and `option`; and the sections that are skipped or refused.

use std::collections::BTreeMap;

use rapier3d::math::Vector;

use super::super::blueprint::{Cone, ContactRules};
use super::super::document::Element;
use super::super::frame::{Angles, vector};
use super::super::softness::Integration;
use super::super::surface::ContactOverride;

/// Sections of a document that are read, or have no effect on the motion.
const SECTIONS: [&str; 15] = [
    "compiler",
    "option",
    "size",
    "statistic",
    "visual",
    "custom",
    "default",
    "asset",
    "worldbody",
    "actuator",
    "contact",
    "equality",
    "tendon",
    "sensor",
    "keyframe",
];
/// Elements of the sections that are read in part.
const CHILDREN: [(&str, &[&str]); 4] = [
    ("compiler", &["lengthrange"]),
    ("option", &["flag"]),
    ("asset", &["texture", "material", "mesh", "hfield", "skin", "model"]),
    ("contact", &["pair", "exclude"]),
];
const COMPILER: [&str; 20] = [
    "angle",
    "eulerseq",
    "coordinate",
    "autolimits",
    "meshdir",
    "assetdir",
    "texturedir",
    "strippath",
    "settotalmass",
    "inertiafromgeom",
    "boundmass",
    "boundinertia",
    "balanceinertia",
    "discardvisual",
    "convexhull",
    "usethread",
    "fusestatic",
    "exactmeshinertia",
    "alignfree",
    "saveinertial",
];
/// Settings that must have these values.
const FIXED: [(&str, &str, &str); 8] = [
    ("compiler", "coordinate", "local"),
    ("compiler", "balanceinertia", "false"),
    ("compiler", "exactmeshinertia", "false"),
    ("compiler", "alignfree", "false"),
    ("option", "density", "0"),
    ("option", "viscosity", "0"),
    ("option", "wind", "0 0 0"),
    ("option", "magnetic", "0 -0.5 0"),
];
/// Settings of MuJoCo's solver, which rapier's replaces.
const SOLVER: [&str; 17] = [
    "solver",
    "iterations",
    "tolerance",
    "ls_iterations",
    "ls_tolerance",
    "noslip_iterations",
    "noslip_tolerance",
    "mpr_iterations",
    "mpr_tolerance",
    "ccd_iterations",
    "ccd_tolerance",
    "sdf_iterations",
    "sdf_initpoints",
    "jacobian",
    "impratio",
    "cone",
    "apirate",
];
/// Flags that do not change the motion, or only MuJoCo's solver.
const FLAGS: [&str; 14] = [
    "energy",
    "fwdinv",
    "invdiscrete",
    "island",
    "midphase",
    "multiccd",
    "nativeccd",
    "sensor",
    "sensornoise",
    "warmstart",
    "filterparent",
    "autoreset",
    "refsafe",
    "eulerdamp",
];
/// Flags that must be enabled.
const ENABLED: [&str; 7] =
    ["constraint", "equality", "frictionloss", "limit", "passive", "clampctrl", "actuation"];

/// Source of the masses of bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum MassSource {
    /// `inertial` where a body has it, shapes elsewhere.
    Stated,
    Shapes,
    Inertials,
}

/// Settings of a document.
pub(super) struct Options {
    pub(super) angles: Angles,
    pub(super) autolimits: bool,
    pub(super) mass_source: MassSource,
    /// kg and kg m^2; bodies must not have less.
    pub(super) least: [f64; 2],
    pub(super) total_mass: Option<f64>,
    pub(super) mesh_folder: String,
    pub(super) strips_paths: bool,
    pub(super) timestep_secs: f64,
    pub(super) gravity: Vector,
    pub(super) integration: Integration,
    pub(super) has_contacts: bool,
    pub(super) contacts: ContactRules,
}

impl Options {
    /// Reads the settings, and what MuJoCo would do in addition.
    pub(super) fn read(root: &Element) -> Result<(Self, Vec<String>), String> {
        check_sections(root)?;
        let [compiler, option, flags] = merged(root);
        compiler.only(&[&COMPILER])?;
        check_fixed(&compiler, &option)?;
        let known =
            ["timestep", "gravity", "integrator", "density", "viscosity", "wind", "magnetic"];
        option.only(&[&SOLVER, &known])?;
        flags.only(&[&FLAGS, &ENABLED, &["contact", "gravity"]])?;
        for flag in ENABLED {
            if flags.flag(flag)? == Some(false) {
                return Err(flags.refuse(format!("{flag}=\"disable\" is not supported")));
            }
        }
        let mut options = Self {
            angles: angles(&compiler)?,
            autolimits: compiler.flag("autolimits")?.unwrap_or(true),
            mass_source: mass_source(&compiler)?,
            least: [compiler.number("boundmass", 0.0)?, compiler.number("boundinertia", 0.0)?],
            total_mass: Some(compiler.number("settotalmass", -1.0)?).filter(|mass| *mass > 0.0),
            mesh_folder: folder(&compiler),
            strips_paths: compiler.flag("strippath")?.unwrap_or(false),
            timestep_secs: option.number("timestep", 0.002)?,
            gravity: vector(option.numbers("gravity")?.unwrap_or([0.0, 0.0, -9.81])),
            integration: integration(&option)?,
            has_contacts: flags.flag("contact")?.unwrap_or(true),
            contacts: contact_rules(&option)?,
        };
        if options.timestep_secs <= 0.0 {
            return Err(option.refuse("`timestep` must be positive"));
        }
        if flags.flag("gravity")? == Some(false) {
            options.gravity = Vector::ZERO;
        }
        Ok((options, differences(&option)?))
    }
}

/// The three elements with all their attributes in the document.
fn merged(root: &Element) -> [Element; 3] {
    let merge = |elements: Vec<&Element>, tag: &str| {
        let mut merged = root.with(BTreeMap::new());
        merged.tag = tag.to_owned();
        for element in elements {
            let mut attributes = std::mem::take(&mut merged.attributes);
            attributes.extend(element.attributes.clone());
            merged = element.with(attributes);
        }
        merged
    };
    let flags = root.all("option").flat_map(|option| option.all("flag")).collect();
    let of = |tag| root.all(tag).collect();
    [merge(of("compiler"), "compiler"), merge(of("option"), "option"), merge(flags, "flag")]
}

fn check_sections(root: &Element) -> Result<(), String> {
    let unknown = |section: &&Element| !SECTIONS.contains(&section.tag.as_str());
    if let Some(section) = root.children.iter().find(unknown) {
        return Err(section.refuse("this element is not supported"));
    }
    for section in &root.children {
        let known = CHILDREN.iter().find(|(tag, _)| *tag == section.tag);
        let unknown =
            |child: &&Element| known.is_some_and(|(_, known)| !known.contains(&child.tag.as_str()));
        if let Some(child) = section.children.iter().find(unknown) {
            return Err(child.refuse("this element is not supported"));
        }
    }
    for constraint in root.all("equality").flat_map(|section| &section.children) {
        if constraint.flag("active")? != Some(false) {
            return Err(constraint.refuse("equality constraints are not supported"));
        }
    }
    let pairs = root.all("contact").flat_map(|section| section.all("pair"));
    if let Some(pair) = pairs.into_iter().next() {
        return Err(pair.refuse("explicit contact pairs are not supported"));
    }
    let passive = ["stiffness", "damping", "frictionloss", "range", "armature"];
    let acts = |tendon: &&Element| passive.iter().any(|name| tendon.text(name).is_some());
    match root.all("tendon").flat_map(|section| &section.children).find(acts) {
        Some(tendon) => Err(tendon.refuse("tendons with forces or limits are not supported")),
        None => Ok(()),
    }
}

fn check_fixed(compiler: &Element, option: &Element) -> Result<(), String> {
    for (tag, name, value) in FIXED {
        let element = if tag == "compiler" { compiler } else { option };
        let numbers = |text: &str| -> Option<Vec<f64>> {
            text.split_ascii_whitespace().map(|number| number.parse().ok()).collect()
        };
        match element.text(name) {
            Some(text)
                if text != value
                    && (numbers(text) != numbers(value) || numbers(text).is_none()) =>
            {
                return Err(element.refuse(format!("{name}=\"{text}\" is not supported")));
            }
            _ => {}
        }
    }
    Ok(())
}

fn angles(compiler: &Element) -> Result<Angles, String> {
    let degrees = match compiler.text("angle") {
        None | Some("degree") => true,
        Some("radian") => false,
        Some(_) => return Err(compiler.refuse("`angle` must be degree or radian")),
    };
    let sequence = compiler.text("eulerseq").unwrap_or("xyz").to_owned();
    if sequence.len() != 3 || !sequence.chars().all(|letter| "xyzXYZ".contains(letter)) {
        return Err(compiler.refuse("`eulerseq` must be three of the letters x, y, z, X, Y and Z"));
    }
    Ok(Angles { degrees, sequence })
}

fn mass_source(compiler: &Element) -> Result<MassSource, String> {
    match compiler.text("inertiafromgeom") {
        None | Some("auto") => Ok(MassSource::Stated),
        Some("true") => Ok(MassSource::Shapes),
        Some("false") => Ok(MassSource::Inertials),
        Some(_) => Err(compiler.refuse("`inertiafromgeom` must be true, false or auto")),
    }
}

fn folder(compiler: &Element) -> String {
    compiler.text("meshdir").or(compiler.text("assetdir")).unwrap_or("").to_owned()
}

/// The implicit integrators treat contacts and limits as the Euler integrator does.
fn integration(option: &Element) -> Result<Integration, String> {
    match option.text("integrator") {
        None | Some("Euler" | "implicit" | "implicitfast") => Ok(Integration::Euler),
        Some("RK4") => Ok(Integration::RungeKutta),
        Some(name) => Err(option.refuse(format!("the integrator `{name}` is not supported"))),
    }
}

fn contact_rules(option: &Element) -> Result<ContactRules, String> {
    let cone = match option.text("cone") {
        None | Some("pyramidal") => Cone::Pyramidal,
        Some("elliptic") => Cone::Elliptic,
        Some(_) => return Err(option.refuse("`cone` must be pyramidal or elliptic")),
    };
    let impratio = option.number("impratio", 1.0)?;
    if impratio <= 0.0 {
        return Err(option.refuse("`impratio` must be positive"));
    }
    Ok(ContactRules { cone, impratio, stated: ContactOverride::default() })
}

fn differences(option: &Element) -> Result<Vec<String>, String> {
    let mut left_out = Vec::new();
    if option.integer("noslip_iterations", 0)? != 0 {
        left_out.push("there is no solver that prevents slip".to_owned());
    }
    Ok(left_out)
}
