//! A network's parameters: named, in the order in which they were declared.

use candle_core::{DType, Device, Tensor, Var};

use crate::arrays::{Array, NamedArrays};
use crate::error::PolicyError;

/// Named parameters. Their order is that of declaration and never that of a hash.
#[derive(Debug, Default)]
pub struct Parameters {
    entries: Vec<(String, Var)>,
}

impl Parameters {
    /// No parameters yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Declares a parameter that starts as `value`.
    ///
    /// # Errors
    /// Passes on a tensor error; refuses a name that is taken.
    pub fn add(&mut self, name: &str, value: Tensor) -> Result<Var, PolicyError> {
        if self.entries.iter().any(|(taken, _)| taken == name) {
            return Err(PolicyError::Restore(format!("parameter {name} is declared twice")));
        }
        let var = Var::from_tensor(&value)?;
        self.entries.push((name.to_owned(), var.clone()));
        Ok(var)
    }

    /// All parameters in their order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Var)> {
        self.entries.iter().map(|(name, var)| (name.as_str(), var))
    }

    /// Number of parameters (tensors).
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Number of scalars in all of them.
    #[must_use]
    pub fn scalars(&self) -> usize {
        self.entries.iter().map(|(_, var)| var.elem_count()).sum()
    }

    /// The parameters as arrays named `PREFIX` + name.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn to_arrays(&self, prefix: &str) -> Result<NamedArrays, PolicyError> {
        let array = |(name, var): (&str, &Var)| Ok((format!("{prefix}{name}"), array_of(var)?));
        self.iter().map(array).collect()
    }

    /// Takes over the arrays named `PREFIX` + name.
    ///
    /// # Errors
    /// Names an array that is missing, unknown under the prefix, or of another shape or type; then
    /// no parameter has changed.
    pub fn load(&self, prefix: &str, arrays: &NamedArrays) -> Result<(), PolicyError> {
        let known = |name: &str| self.iter().any(|(own, _)| own == name);
        let extra = arrays.keys().filter_map(|name| name.strip_prefix(prefix)).find(|n| !known(n));
        if let Some(name) = extra {
            return Err(PolicyError::Restore(format!("{prefix}{name} belongs to no parameter")));
        }
        let values = self
            .iter()
            .map(|(name, var)| stored(arrays, &format!("{prefix}{name}"), var))
            .collect::<Result<Vec<_>, _>>()?;
        for ((_, var), value) in self.iter().zip(values) {
            var.set(&value)?;
        }
        Ok(())
    }
}

fn array_of(var: &Var) -> Result<Array, PolicyError> {
    let (shape, flat) = (var.dims().to_vec(), var.as_tensor().flatten_all()?);
    Ok(match var.dtype() {
        DType::F64 => Array::F64 { shape, data: flat.to_vec1()? },
        _ => Array::F32 { shape, data: flat.to_vec1()? },
    })
}

fn stored(arrays: &NamedArrays, name: &str, var: &Var) -> Result<Tensor, PolicyError> {
    let array =
        arrays.get(name).ok_or_else(|| PolicyError::Restore(format!("{name} is missing")))?;
    let wrong = || {
        let (expected, kind) = (var.dims(), var.dtype());
        let found = array.shape();
        PolicyError::Restore(format!("{name} has shape {found:?}, expected {expected:?} {kind:?}"))
    };
    if array.shape() != var.dims() {
        return Err(wrong());
    }
    match (array, var.dtype()) {
        (Array::F32 { data, .. }, DType::F32) => {
            Ok(Tensor::from_slice(data, var.dims(), &Device::Cpu)?)
        }
        (Array::F64 { data, .. }, DType::F64) => {
            Ok(Tensor::from_slice(data, var.dims(), &Device::Cpu)?)
        }
        _ => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameters() -> Parameters {
        let mut parameters = Parameters::new();
        for (name, values) in [("z", [1.0_f32, 2.0]), ("a", [3.0, 4.0])] {
            let tensor = Tensor::new(&values, &Device::Cpu).expect("two numbers");
            parameters.add(name, tensor).expect("a new name");
        }
        parameters
    }

    #[test]
    fn parameters_keep_the_order_of_their_declaration() {
        let names: Vec<String> = parameters().iter().map(|(name, _)| name.to_owned()).collect();
        assert_eq!(names, ["z", "a"]);
        assert_eq!((parameters().len(), parameters().scalars()), (2, 4));
    }

    #[test]
    fn loading_is_strict_and_names_what_is_wrong() {
        let source = parameters().to_arrays("p.").expect("f32 arrays");
        let target = parameters();
        assert!(target.load("p.", &source).is_ok());
        let mut missing = source.clone();
        missing.remove("p.a");
        let mut extra = source.clone();
        extra.insert("p.b".to_owned(), Array::F32 { shape: vec![0], data: vec![] });
        let mut reshaped = source.clone();
        reshaped.insert("p.a".to_owned(), Array::F32 { shape: vec![1], data: vec![9.0] });
        for (arrays, name) in [(missing, "p.a is missing"), (extra, "p.b"), (reshaped, "p.a has")] {
            let error = target.load("p.", &arrays).expect_err(name).to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
