//! A layer of settings.

use std::collections::BTreeMap;

use super::scalar::Scalar;

/// Values of one place.
pub(super) struct Layer {
    pub(super) place: String,
    pub(super) values: BTreeMap<String, Scalar>,
}
