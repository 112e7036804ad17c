//! Default classes, options and meshes of a model, on which the reading of its elements depends.

use std::collections::{BTreeMap, BTreeSet};

use super::super::document::{Classes, Element};
use super::blockers::Blockers;
use super::meshes::Meshes;
use super::options::Options;
use super::{contacts, fields};

/// Default classes, options and meshes of a model.
pub(super) struct Context {
    pub(super) classes: Classes,
    pub(super) options: Options,
    pub(super) meshes: Meshes,
    /// Height fields by name.
    pub(super) fields: BTreeMap<String, Element>,
    /// Names of the shapes in contact pairs.
    pub(super) paired: BTreeSet<String>,
    /// All names in the document.
    names: BTreeSet<String>,
    /// What cannot be built.
    pub(super) blockers: Blockers,
}

impl Context {
    /// Reads the settings, and what MuJoCo would do in addition to this simulator.
    pub(super) fn read(root: &Element) -> Result<(Self, Vec<String>), String> {
        let blockers = Blockers::default();
        // Without these, nothing else can be read; the message has the reasons so far, too.
        let stop = |reason| blockers.finish_with(reason);
        let (options, left_out) = Options::read(root, &blockers).map_err(stop)?;
        let classes = Classes::new(root).map_err(stop)?;
        let meshes = Meshes::read(root, &classes, &options).map_err(stop)?;
        let paired = contacts::paired(root);
        let fields = fields::read(root);
        let mut names = BTreeSet::new();
        collect_names(root, &mut names);
        Ok((Self { classes, options, meshes, fields, paired, names, blockers }, left_out))
    }

    /// Error message for an attribute that names no `kind`; `known` are the names of all. It is empty if the document states
    /// the name, for an element that could not be read.
    pub(super) fn unknown<'a>(
        &self,
        element: &Element,
        attribute: &str,
        (kind, known): (&str, impl IntoIterator<Item = &'a str>),
    ) -> String {
        let name = element.text(attribute).unwrap_or_default();
        if !self.blockers.is_empty() && self.names.contains(name) {
            return String::new();
        }
        element.refuse_name(attribute, kind, known)
    }
}

fn collect_names(element: &Element, names: &mut BTreeSet<String>) {
    names.extend(element.text("name").map(str::to_owned));
    element.children.iter().for_each(|child| collect_names(child, names));
}
