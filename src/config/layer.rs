//! A layer of settings.

use std::collections::BTreeMap;

use super::scalar::Scalar;

/// Who chose the values of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// The program, or the run that is resumed.
    Program,
    /// The user.
    User,
    /// The user, by repeating a whole configuration; values that equal those of the layers below are not the user's choice.
    Repeated,
}

/// Values of one place.
pub(super) struct Layer {
    pub(super) place: String,
    pub(super) source: Source,
    pub(super) values: BTreeMap<String, Scalar>,
}
