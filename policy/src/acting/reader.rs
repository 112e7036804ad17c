//! Reads a policy's layers from its arrays; errors name the array.

use crate::arrays::{Array, NamedArrays};
use crate::error::PolicyError;
use crate::layers::LayerSpec;
use crate::standardisation::{INVERSE, MEAN, Standardisation};

/// Reads arrays by name, checks their shapes and counts them.
pub(super) struct Reader<'a> {
    pub(super) arrays: &'a NamedArrays,
    pub(super) used: usize,
}

impl Reader<'_> {
    /// The elements of the array with this name and shape.
    pub(super) fn array(&mut self, name: &str, expected: &[usize]) -> Result<&[f32], PolicyError> {
        let wrong = |what: String| PolicyError::Snapshot(format!("{name} {what}"));
        match self.arrays.get(name) {
            Some(Array::F32 { shape, data }) if shape == expected => {
                if data.iter().any(|x| !x.is_finite()) {
                    return Err(wrong("has a value that is not finite".to_owned()));
                }
                self.used += 1;
                Ok(data)
            }
            Some(other) => {
                let found = other.shape();
                Err(wrong(format!("has shape {found:?}, expected f32 {expected:?}")))
            }
            None => Err(wrong("is missing".to_owned())),
        }
    }

    /// The standardisation of observations, if present.
    pub(super) fn standardisation(
        &mut self,
        width: usize,
    ) -> Result<Option<Standardisation>, PolicyError> {
        if !self.arrays.contains_key(MEAN) {
            return Ok(None);
        }
        let mean = self.array(MEAN, &[width])?.to_vec();
        let inverse = self.array(INVERSE, &[width])?.to_vec();
        Ok(Some(Standardisation { mean, inverse }))
    }

    /// The concatenated parameters of the layers.
    pub(super) fn layers(&mut self, layers: &[LayerSpec]) -> Result<Vec<f32>, PolicyError> {
        let mut all = Vec::new();
        for (name, shape) in layers.iter().flat_map(LayerSpec::parameters) {
            all.extend_from_slice(self.array(&name, &shape)?);
        }
        Ok(all)
    }
}
