//! Default classes, options and meshes of a model, on which the reading of its elements depends.

use std::collections::BTreeSet;

use super::super::document::{Classes, Element};
use super::blockers::Blockers;
use super::contacts;
use super::meshes::Meshes;
use super::options::Options;

/// Default classes, options and meshes of a model.
pub(super) struct Context {
    pub(super) classes: Classes,
    pub(super) options: Options,
    pub(super) meshes: Meshes,
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
        Ok((Self { classes, options, meshes, paired, blockers }, left_out))
    }
}
