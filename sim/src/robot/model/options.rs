//! Settings of a document: `compiler` and `option`; and the sections that are skipped or refused.

use rapier3d::math::Vector;

use super::super::blueprint::{Cone, ContactRules};
use super::super::document::{Element, SECTIONS, check_names};
use super::super::fluid::Fluid;
use super::super::frame::{Angles, vector};
use super::super::softness::{ImplicitForces, Integration};
use super::super::surface::ContactOverride;
use super::blockers::Blockers;

/// Elements of the sections that are read in part.
const CHILDREN: [(&str, &[&str]); 4] = [
    ("compiler", &["lengthrange"]),
    ("option", &["flag"]),
    ("asset", &["texture", "material", "mesh", "hfield", "skin", "model"]),
    ("contact", &["pair", "exclude"]),
];
/// Sections without attributes, and the most elements in all sections of a name.
const PLAIN: [(&str, usize); 7] = [
    ("asset", 5000),
    ("worldbody", 5000),
    ("actuator", 1000),
    ("contact", 5000),
    ("equality", 1000),
    ("tendon", 1000),
    ("keyframe", 1000),
];
/// Sections whose elements have different names, whatever their tags.
const NAMED: [&str; 3] = ["actuator", "equality", "tendon"];
const COMPILER: [&str; 22] = [
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
    "inertiagrouprange",
    "fitaabb",
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
const FIXED: [(&str, &str, &str); 4] = [
    ("compiler", "fitaabb", "false"),
    ("compiler", "coordinate", "local"),
    ("compiler", "exactmeshinertia", "false"),
    ("option", "magnetic", "0 -0.5 0"),
];
/// Settings of MuJoCo's solver and collision detection, which have others here, and of contacts, which are read.
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
/// Flags that do not change the motion, or only MuJoCo's solver and contact points.
const FLAGS: [&str; 11] = [
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
    "autoreset",
];
/// Flags that count as enabled, with what then differs from the model.
const KEPT: [(&str, &str); 1] = [(
    "refsafe",
    "the time constant of `solref` is at least two steps, as with the flag `refsafe`",
)];
/// Flags that count as the model has them, besides [`CONSTRAINTS`].
const READ: [&str; 3] = ["eulerdamp", "filterparent", "gravity"];
/// Flags that must be enabled. MuJoCo 4.0.0 has `spring` and `damper` in place of `passive`.
const ENABLED: [&str; 5] = ["passive", "spring", "damper", "clampctrl", "actuation"];
/// Flags that must be disabled.
const DISABLED: [&str; 2] = ["sleep", "override"];
/// Flags without which some or all constraints do not act.
const CONSTRAINTS: [&str; 5] = ["constraint", "contact", "equality", "frictionloss", "limit"];

const MASS_SOURCES: [(&str, MassSource); 3] =
    [("auto", MassSource::Stated), ("true", MassSource::Shapes), ("false", MassSource::Inertials)];
/// The implicit integrators treat contacts and limits as the Euler integrator does.
const INTEGRATORS: [(&str, Integration); 4] = [
    ("Euler", Integration::Euler),
    ("implicit", Integration::Euler),
    ("implicitfast", Integration::Euler),
    ("RK4", Integration::RungeKutta),
];
const CONES: [(&str, Cone); 2] = [("pyramidal", Cone::Pyramidal), ("elliptic", Cone::Elliptic)];
/// Groups of shapes.
const ALL_GROUPS: [i64; 2] = [0, 5];

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
    /// First and last group of the shapes that have masses.
    pub(super) mass_groups: [i64; 2],
    /// kg and kg m^2; bodies must not have less.
    pub(super) least: [f64; 2],
    pub(super) total_mass: Option<f64>,
    /// Whether principal moments that no body can have are replaced by their mean.
    pub(super) balances: bool,
    /// Whether the frames of free bodies are those of their inertia.
    pub(super) aligns_free: bool,
    pub(super) mesh_folder: String,
    pub(super) strips_paths: bool,
    pub(super) timestep_secs: f64,
    pub(super) gravity: Vector,
    pub(super) integration: Integration,
    pub(super) implicit: ImplicitForces,
    pub(super) has_contacts: bool,
    pub(super) contacts: ContactRules,
    /// The fluid that fills the world, without boxes.
    pub(super) fluid: Fluid,
    /// Whether equality constraints act.
    pub(super) has_equalities: bool,
    /// Whether joints have limits.
    pub(super) has_limits: bool,
    /// Whether joints have dry friction.
    pub(super) has_friction: bool,
}

impl Options {
    /// Reads the settings, and what MuJoCo would do in addition.
    pub(super) fn read(root: &Element, blockers: &Blockers) -> (Self, Vec<String>) {
        check_sections(root, blockers);
        let [compiler, option, flags] = merged(root);
        blockers.keep(compiler.only(&[&COMPILER]));
        check_fixed(&compiler, &option, blockers);
        let known =
            ["timestep", "gravity", "integrator", "density", "viscosity", "wind", "magnetic"];
        blockers.keep(option.only(&[&SOLVER, &known]));
        check_flags(&flags, blockers);
        let on = |flag: &str| blockers.keep(flags.flag(flag)).flatten();
        let is_set = |name: &str| blockers.keep(compiler.flag(name)).flatten();
        let [constraints, contacts, equalities, friction, limits] =
            CONSTRAINTS.map(|flag| on(flag).unwrap_or(true));
        let gravity = blockers.keep(option.numbers("gravity")).flatten();
        let options = Self {
            angles: blockers.keep(angles(&compiler)).unwrap_or_default(),
            autolimits: is_set("autolimits").unwrap_or(true),
            mass_source: blockers
                .keep(compiler.word("inertiafromgeom", &MASS_SOURCES))
                .unwrap_or(MassSource::Stated),
            mass_groups: blockers.keep(mass_groups(&compiler)).unwrap_or(ALL_GROUPS),
            least: ["boundmass", "boundinertia"].map(|name| blockers.number(&compiler, name, 0.0)),
            total_mass: Some(blockers.number(&compiler, "settotalmass", -1.0))
                .filter(|mass| *mass > 0.0),
            balances: is_set("balanceinertia").unwrap_or(false),
            aligns_free: is_set("alignfree").unwrap_or(false),
            mesh_folder: mesh_folder(root),
            strips_paths: is_set("strippath").unwrap_or(false),
            timestep_secs: blockers.number(&option, "timestep", 0.002),
            gravity: match on("gravity") {
                Some(false) => Vector::ZERO,
                _ => vector(gravity.unwrap_or([0.0, 0.0, -9.81])),
            },
            integration: blockers
                .keep(option.word("integrator", &INTEGRATORS))
                .unwrap_or(Integration::Euler),
            implicit: match option.text("integrator") {
                Some("RK4") => ImplicitForces::Nothing,
                Some("implicit" | "implicitfast") => ImplicitForces::All,
                _ if on("eulerdamp") == Some(false) => ImplicitForces::Nothing,
                _ => ImplicitForces::Damping,
            },
            has_contacts: constraints && contacts,
            has_equalities: constraints && equalities,
            has_limits: constraints && limits,
            has_friction: constraints && friction,
            contacts: contact_rules(&option, &flags, blockers),
            fluid: fluid(&option, blockers),
        };
        let differences = blockers.keep(differences(&compiler, &option, &flags));
        (options, differences.unwrap_or_default())
    }
}

/// The three elements with all their attributes in the document.
fn merged(root: &Element) -> [Element; 3] {
    let flags = root.all("option").flat_map(|option| option.all("flag"));
    [
        Element::merged("compiler", root.all("compiler")),
        Element::merged("option", root.all("option")),
        Element::merged("flag", flags),
    ]
}

/// Refuses sections with too many elements.
pub(super) fn check_size(root: &Element) -> Result<(), String> {
    let counts =
        PLAIN.map(|(tag, most)| (tag, root.all(tag).flat_map(|own| &own.children).count(), most));
    match counts.into_iter().find(|(_, count, most)| count > most) {
        None => Ok(()),
        Some((tag, count, most)) => {
            Err(format!("<{tag}> has {count} elements, at most {most} are allowed; remove some"))
        }
    }
}

fn check_sections(root: &Element, blockers: &Blockers) {
    blockers.keep(root.only(&[&["model"]]));
    for (tag, _) in PLAIN {
        for section in root.all(tag) {
            blockers.keep(section.only(&[]));
        }
        let elements = root.all(tag).flat_map(|section| &section.children);
        if NAMED.contains(&tag) {
            blockers.keep(check_names(elements));
        }
    }
    for section in &root.children {
        if !SECTIONS.contains(&section.tag.as_str()) {
            blockers.note(section.refuse_element());
        }
        let known = CHILDREN.iter().find(|(tag, _)| *tag == section.tag);
        let Some((_, known)) = known else { continue };
        for child in section.children.iter().filter(|child| !known.contains(&child.tag.as_str())) {
            blockers.note(child.refuse_element());
        }
    }
}

fn check_fixed(compiler: &Element, option: &Element, blockers: &Blockers) {
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
                let reason = format!("{name}=\"{text}\" is not supported; set {value}");
                blockers.note(element.refuse_for(name, reason));
            }
            _ => {}
        }
    }
}

/// Refuses unknown flags, and those that must be enabled or disabled and are not.
fn check_flags(flags: &Element, blockers: &Blockers) {
    let kept = KEPT.map(|(flag, _)| flag);
    blockers.keep(flags.only(&[&FLAGS, &kept, &ENABLED, &DISABLED, &CONSTRAINTS, &READ]));
    let fixed = ENABLED.map(|flag| (flag, false)).into_iter();
    for (flag, value) in fixed.chain(DISABLED.map(|flag| (flag, true))) {
        if blockers.keep(flags.flag(flag)).flatten() == Some(value) {
            let word = if value { "enable" } else { "disable" };
            let reason = format!("{flag}=\"{word}\" is not supported; remove it");
            blockers.note(flags.refuse_for(flag, reason));
        }
    }
}

/// Units of the angles in a document.
pub(super) fn angles_of(root: &Element) -> Result<Angles, String> {
    angles(&Element::merged("compiler", root.all("compiler")))
}

fn angles(compiler: &Element) -> Result<Angles, String> {
    let degrees = compiler.word("angle", &[("degree", true), ("radian", false)])?;
    let sequence = compiler.text("eulerseq").unwrap_or("xyz").to_owned();
    if sequence.len() != 3 || !sequence.chars().all(|letter| "xyzXYZ".contains(letter)) {
        let reason = "`eulerseq` must be three of the letters x, y, z, X, Y and Z";
        return Err(compiler.refuse_for("eulerseq", reason));
    }
    Ok(Angles { degrees, sequence })
}

fn mass_groups(compiler: &Element) -> Result<[i64; 2], String> {
    match compiler.numbers::<2>("inertiagrouprange")? {
        Some([first, last]) if first > last => {
            let reason = "`inertiagrouprange` must ascend, such as 0 5";
            Err(compiler.refuse_for("inertiagrouprange", reason))
        }
        range => Ok(range.map_or(ALL_GROUPS, |range| range.map(|group| group as i64))),
    }
}

/// Folder of the last `compiler` that states one; in the same element, `meshdir` counts.
fn mesh_folder(root: &Element) -> String {
    let stated = |compiler: &Element| {
        compiler.text("meshdir").or(compiler.text("assetdir")).map(str::to_owned)
    };
    root.all("compiler").filter_map(stated).last().unwrap_or_default()
}

fn contact_rules(option: &Element, flags: &Element, blockers: &Blockers) -> ContactRules {
    ContactRules {
        cone: blockers.keep(option.word("cone", &CONES)).unwrap_or(Cone::Pyramidal),
        impratio: blockers.number(option, "impratio", 1.0),
        stated: ContactOverride::default(),
        pairs: Vec::new(),
        excluded: Vec::new(),
        parents_touch: blockers.keep(flags.flag("filterparent")).flatten() == Some(false),
        links_touch: false,
    }
}

fn fluid(option: &Element, blockers: &Blockers) -> Fluid {
    Fluid {
        density: blockers.number(option, "density", 0.0),
        viscosity: blockers.number(option, "viscosity", 0.0),
        wind: blockers.keep(option.numbers("wind")).flatten().unwrap_or_default(),
        boxes: Vec::new(),
    }
}

fn differences(
    compiler: &Element,
    option: &Element,
    flags: &Element,
) -> Result<Vec<String>, String> {
    let mut left_out = Vec::new();
    if compiler.flag("fusestatic")? == Some(true) {
        let what =
            "bodies without joints are not fused: their contacts are as with fusestatic=\"false\"";
        left_out.push(what.to_owned());
    }
    if option.integer("noslip_iterations", 0)? != 0 {
        left_out.push("there is no solver that prevents slip".to_owned());
    }
    let count = option.integer("iterations", 100)?;
    if count < 10 {
        left_out.push(format!("constraints are solved to convergence, not in {count} iterations"));
    }
    if option.text("integrator") == Some("implicit") {
        let what = "the integrator is `implicitfast`: only single free bodies have derivatives of gyroscopic forces";
        left_out.push(what.to_owned());
    }
    for (flag, what) in KEPT {
        if flags.flag(flag)? == Some(false) {
            left_out.push(what.to_owned());
        }
    }
    Ok(left_out)
}
