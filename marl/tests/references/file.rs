//! A file of reference values, and comparisons with them.

use policy::{Array, NamedArrays, arrays};

/// Named arrays of the file.
pub(crate) struct ReferenceValues(NamedArrays);

impl ReferenceValues {
    pub(crate) fn of(bytes: &[u8]) -> Self {
        Self(arrays::from_safetensors(bytes).unwrap().0)
    }

    pub(crate) fn array(&self, name: &str) -> &Array {
        self.0.get(name).unwrap_or_else(|| panic!("the reference has no {name}"))
    }

    pub(crate) fn numbers(&self, name: &str) -> Vec<f64> {
        numbers(self.array(name))
    }

    /// Values that are exact in single precision.
    pub(crate) fn single(&self, name: &str) -> Vec<f32> {
        self.numbers(name).into_iter().map(|x| x as f32).collect()
    }

    pub(crate) fn flags(&self, name: &str) -> Vec<bool> {
        self.numbers(name).into_iter().map(|x| x != 0.0).collect()
    }

    pub(crate) fn setting(&self, key: &str) -> f64 {
        self.numbers(&format!("settings/{key}"))[0]
    }

    /// The arrays whose names begin with `prefix`, by the remainder of their names.
    pub(crate) fn under<'a>(&'a self, prefix: &str) -> Vec<(&'a str, &'a Array)> {
        let named =
            |(name, array): (&'a String, &'a Array)| Some((name.strip_prefix(prefix)?, array));
        self.0.iter().filter_map(named).collect()
    }

    /// Asserts that `found` equals the array `expected/NAME` to double precision.
    pub(crate) fn expects(&self, name: &str, found: &[f64]) {
        let name = format!("expected/{name}");
        agree(&name, found, &self.numbers(&name), 1e-9);
    }
}

pub(crate) fn numbers(array: &Array) -> Vec<f64> {
    match array {
        Array::F32 { data, .. } => data.iter().map(|&x| f64::from(x)).collect(),
        Array::F64 { data, .. } => data.clone(),
        Array::I64 { data, .. } => data.iter().map(|&x| x as f64).collect(),
        Array::U8 { data, .. } => data.iter().map(|&x| f64::from(x)).collect(),
    }
}

/// Asserts that no difference exceeds `tolerance` times the array's largest magnitude.
pub(crate) fn agree(name: &str, found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len(), "{name}");
    let largest = expected.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
        let error = (found - expected).abs();
        let within = error <= tolerance * largest;
        assert!(within, "{name}[{at}] is {found}, PyTorch has {expected}; largest {largest}");
    }
}
