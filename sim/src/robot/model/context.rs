//! Default classes, options and meshes of a model, on which the reading of its elements depends.

use std::collections::{BTreeMap, BTreeSet};

use super::super::document::{Classes, Element};
use super::blockers::Blockers;
use super::meshes::Meshes;
use super::options::{self, Options};
use super::{contacts, fields};

/// Attributes that name a joint on which an element acts.
const JOINTS: [&str; 4] = ["joint", "jointinparent", "joint1", "joint2"];

/// Default classes, options and meshes of a model.
pub(super) struct Context {
    pub(super) classes: Classes,
    pub(super) options: Options,
    pub(super) meshes: Meshes,
    /// Height fields by name.
    pub(super) fields: BTreeMap<String, Element>,
    /// Names of the shapes in contact pairs.
    pub(super) paired: BTreeSet<String>,
    /// Names of the joints on which actuators, tendons and equalities act.
    pub(super) driven: BTreeSet<String>,
    /// Names of the sites that equalities connect and on which actuators act.
    pub(super) sites: BTreeSet<String>,
    /// All names in the document.
    names: BTreeSet<String>,
    /// What cannot be built.
    pub(super) blockers: Blockers,
}

impl Context {
    /// Reads the settings, and what MuJoCo would do in addition to this simulator.
    pub(super) fn read(root: &Element) -> Result<(Self, Vec<String>), String> {
        let blockers = Blockers::default();
        let (options, left_out) = Options::read(root, &blockers);
        let (classes, reasons) = Classes::new(root);
        reasons.into_iter().for_each(|reason| blockers.note(reason));
        // To read a larger document would take long.
        if blockers.keep(options::check_size(root)).is_none() {
            blockers.finish()?;
        }
        let meshes = Meshes::read(root, &classes, &options, &blockers);
        let paired = contacts::paired(root);
        let fields = fields::read(root, &blockers);
        let mut driven = BTreeSet::new();
        let acting = ["actuator", "tendon", "equality"];
        acting
            .iter()
            .flat_map(|tag| root.all(tag))
            .for_each(|own| collect(own, &JOINTS, &mut driven));
        let mut sites = BTreeSet::new();
        root.all("equality").for_each(|own| collect(own, &["site1", "site2"], &mut sites));
        root.all("actuator").for_each(|own| collect(own, &["site"], &mut sites));
        let mut names = BTreeSet::new();
        collect(root, &["name"], &mut names);
        let context =
            Self { classes, options, meshes, fields, paired, driven, sites, names, blockers };
        Ok((context, left_out))
    }

    /// Range that an attribute states; `None` if it does not limit anything. As in MuJoCo, ends that do not ascend are no
    /// range, unless the attribute `limited` says so.
    pub(super) fn range(
        &self,
        element: &Element,
        [name, limited]: [&str; 2],
    ) -> Result<Option<[f64; 2]>, String> {
        let ends = element.numbers(name)?.unwrap_or_default();
        let ascends = matches!(ends.map(|end: f64| end as f32), [low, high] if low < high);
        match element.flag(limited)? {
            Some(true) if !ascends => {
                let reason = format!(
                    "`{name}` must have a lower and a higher end; set it, or {limited}=\"false\""
                );
                Err(element.refuse_for(name, reason))
            }
            None if !self.options.autolimits && ends != [0.0; 2] => {
                let reason =
                    format!("without `autolimits`, `{limited}` must be true or false; set it");
                Err(element.refuse_for(name, reason))
            }
            is_limited => Ok(Some(ends).filter(|_| is_limited.unwrap_or(ascends))),
        }
    }

    /// Range of a joint or tendon, with its ends in the unit and from the origin of `coordinate`, unless limits are disabled.
    pub(super) fn limits(
        &self,
        element: &Element,
        coordinate: impl Fn(f64) -> f32,
    ) -> Result<Option<[f32; 2]>, String> {
        let range = self.range(element, ["range", "limited"])?;
        Ok(range.filter(|_| self.options.has_limits).map(|ends| ends.map(coordinate)))
    }

    /// Dry friction of a joint or tendon, unless it is disabled.
    pub(super) fn friction(&self, element: &Element) -> Result<f32, String> {
        let friction = element.number("frictionloss", 0.0)?;
        Ok(if self.options.has_friction { friction as f32 } else { 0.0 })
    }

    /// Index among `known` of the part that an attribute names. The error is empty if the document states the name, for an
    /// element that could not be read.
    pub(super) fn index<'a>(
        &self,
        element: &Element,
        attribute: &str,
        (kind, known): (&str, impl IntoIterator<Item = &'a str>),
    ) -> Result<usize, String> {
        let missing = || element.refuse(format!("it must have `{attribute}`; add it"));
        let name = element.text(attribute).ok_or_else(missing)?;
        let known: Vec<&str> = known.into_iter().collect();
        known.iter().position(|known| *known == name).ok_or_else(|| {
            let follows = !self.blockers.is_empty() && self.names.contains(name);
            if follows { String::new() } else { element.refuse_name(attribute, kind, known) }
        })
    }
}

/// Adds the texts of these attributes of an element and of all elements inside it.
fn collect(element: &Element, attributes: &[&str], texts: &mut BTreeSet<String>) {
    texts.extend(attributes.iter().filter_map(|name| element.text(name)).map(str::to_owned));
    element.children.iter().for_each(|child| collect(child, attributes, texts));
}
