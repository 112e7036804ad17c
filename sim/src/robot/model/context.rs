//! Default classes, options and meshes of a model, on which the reading of its elements depends.

use super::super::document::{Classes, Element};
use super::meshes::Meshes;
use super::options::Options;

/// Default classes, options and meshes of a model.
pub(super) struct Context {
    pub(super) classes: Classes,
    pub(super) options: Options,
    pub(super) meshes: Meshes,
}

impl Context {
    /// Reads the settings, and what MuJoCo would do in addition to this simulator.
    pub(super) fn read(root: &Element) -> Result<(Self, Vec<String>), String> {
        let (options, left_out) = Options::read(root)?;
        let classes = Classes::new(root)?;
        let meshes = Meshes::read(root, &classes, &options)?;
        Ok((Self { classes, options, meshes }, left_out))
    }
}
