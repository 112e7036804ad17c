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
    /// What cannot be built.
    pub(super) blockers: Blockers,
}

impl Context {
    /// Reads the settings, and what MuJoCo would do in addition to this simulator.
    pub(super) fn read(root: &Element) -> Result<(Self, Vec<String>), String> {
        let blockers = Blockers::default();
        let (options, left_out) = Options::read(root, &blockers)?;
        let classes = Classes::new(root)?;
        let meshes = Meshes::read(root, &classes, &options)?;
        let paired = contacts::paired(root);
        let fields = fields::read(root);
        Ok((Self { classes, options, meshes, fields, paired, blockers }, left_out))
    }
}
