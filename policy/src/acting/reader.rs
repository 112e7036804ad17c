//! Reading a policy's layers from its arrays, with refusals that name the array.

use super::ActorSpec;
use super::layers::{Dense, Norm, Trunk};
use crate::arrays::{Array, NamedArrays};
use crate::config::CoreKind;
use crate::error::PolicyError;
use crate::standardisation::{INVERSE, MEAN, Standardisation};

/// Takes arrays out of their map, checking names and shapes.
pub(super) struct Reader<'a> {
    pub(super) arrays: &'a NamedArrays,
    pub(super) used: usize,
}

impl Reader<'_> {
    fn array(&mut self, name: &str, expected: &[usize]) -> Result<&[f32], PolicyError> {
        let wrong = |what: String| PolicyError::Snapshot(format!("{name} {what}"));
        match self.arrays.get(name) {
            Some(Array::F32 { shape, data }) if shape == expected => {
                if data.iter().any(|x| !x.is_finite()) {
                    return Err(wrong("holds a number that is not finite".to_owned()));
                }
                self.used += 1;
                Ok(data)
            }
            Some(other) => {
                let found = other.shape();
                Err(wrong(format!("has shape {found:?}, expected f32 numbers {expected:?}")))
            }
            None => Err(wrong("is missing".to_owned())),
        }
    }

    pub(super) fn vector(&mut self, name: &str, length: usize) -> Result<Vec<f32>, PolicyError> {
        Ok(self.array(name, &[length])?.to_vec())
    }

    pub(super) fn dense(
        &mut self,
        name: &str,
        from: usize,
        to: usize,
    ) -> Result<Dense, PolicyError> {
        self.linear_map([&format!("{name}.weight"), &format!("{name}.bias")], from, to)
    }

    fn linear_map(
        &mut self,
        names: [&str; 2],
        from: usize,
        to: usize,
    ) -> Result<Dense, PolicyError> {
        let weight = self.array(names[0], &[to, from])?.to_vec();
        Ok(Dense::new(&weight, self.array(names[1], &[to])?))
    }

    /// How observations are standardised, where they are.
    pub(super) fn standardisation(
        &mut self,
        width: usize,
    ) -> Result<Option<Standardisation>, PolicyError> {
        if !self.arrays.contains_key(MEAN) {
            return Ok(None);
        }
        let (mean, inverse) = (self.vector(MEAN, width)?, self.vector(INVERSE, width)?);
        Ok(Some(Standardisation { mean, inverse }))
    }

    fn norm(&mut self, name: &str, width: usize) -> Result<Norm, PolicyError> {
        let weight = self.vector(&format!("{name}.weight"), width)?;
        Ok(Norm { weight, bias: self.vector(&format!("{name}.bias"), width)? })
    }

    pub(super) fn trunk(&mut self, spec: &ActorSpec) -> Result<Trunk, PolicyError> {
        let norm = self.norm("encoder.norm", spec.observation)?;
        match spec.core {
            CoreKind::Gru => {
                let gates = 3 * spec.hidden;
                let (ih, hh) = (["gru.weight_ih", "gru.bias_ih"], ["gru.weight_hh", "gru.bias_hh"]);
                Ok(Trunk::Gru {
                    norm,
                    encoder: self.dense("encoder.linear", spec.observation, spec.encoder)?,
                    input: self.linear_map(ih, spec.encoder, gates)?,
                    recurrent: self.linear_map(hh, spec.hidden, gates)?,
                    output: self.norm("output.norm", spec.hidden)?,
                })
            }
            CoreKind::Mlp => {
                let mut layers = Vec::new();
                let mut from = spec.observation;
                for layer in 0..spec.layers {
                    let dense = self.dense(&format!("layers.{layer}.linear"), from, spec.width)?;
                    layers.push((dense, self.norm(&format!("layers.{layer}.norm"), spec.width)?));
                    from = spec.width;
                }
                Ok(Trunk::Mlp { norm, layers })
            }
        }
    }
}
