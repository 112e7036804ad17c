//! A network's named parameters.

use core::ops::Range;

use candle_core::{Device, Tensor, Var};

use crate::arrays::{Array, NamedArrays};
use crate::error::PolicyError;

/// Named parameters in the order of their declaration.
#[derive(Debug, Default)]
pub struct Parameters {
    spans: Vec<TensorSpan>,
    vars: Vec<Var>,
}

/// Location of a parameter in the flat variables.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorSpan {
    /// The parameter's name.
    pub name: String,
    /// Its shape; elements are row-major.
    pub shape: Vec<usize>,
    /// Index of its variable.
    pub var: usize,
    /// Range of its elements in the variable.
    pub range: Range<usize>,
}

impl Parameters {
    /// No parameters.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Declares a parameter with the initial value `value` in a separate variable.
    ///
    /// # Errors
    /// If a name is already declared; passes on a tensor error.
    pub fn add(&mut self, name: &str, value: Tensor) -> Result<Var, PolicyError> {
        let shape = value.dims().to_vec();
        self.declare(vec![(name.to_owned(), shape)], Var::from_tensor(&value)?)
    }

    /// Declares parameters that share one flat variable; `start` has their concatenated initial values.
    ///
    /// # Errors
    /// If a name is already declared; passes on a tensor error.
    pub fn add_all(
        &mut self,
        named: Vec<(String, Vec<usize>)>,
        start: Vec<f32>,
    ) -> Result<Var, PolicyError> {
        let count = start.len();
        self.declare(named, Var::from_vec(start, count, &Device::Cpu)?)
    }

    fn declare(&mut self, named: Vec<(String, Vec<usize>)>, var: Var) -> Result<Var, PolicyError> {
        let mut end = 0;
        for (name, shape) in named {
            if self.spans.iter().any(|span| span.name == name) {
                return Err(PolicyError::Restore(format!("parameter {name} is declared twice")));
            }
            let range = end..end + shape.iter().product::<usize>();
            end = range.end;
            self.spans.push(TensorSpan { name, shape, var: self.vars.len(), range });
        }
        self.vars.push(var.clone());
        Ok(var)
    }

    /// The parameters of `self`, then those of `other` with `prefix` before their names. The variables are shared.
    #[must_use]
    pub fn with(&self, prefix: &str, other: &Self) -> Self {
        let first = self.vars.len();
        let renamed = other.spans.iter().map(|span| TensorSpan {
            name: format!("{prefix}{}", span.name),
            var: first + span.var,
            ..span.clone()
        });
        Self {
            spans: self.spans.iter().cloned().chain(renamed).collect(),
            vars: self.vars.iter().chain(&other.vars).cloned().collect(),
        }
    }

    /// The locations of all parameters, in order.
    #[must_use]
    pub fn spans(&self) -> &[TensorSpan] {
        &self.spans
    }

    /// All variables, in order.
    #[must_use]
    pub fn vars(&self) -> &[Var] {
        &self.vars
    }

    /// Name of the first parameter in the variable `index`.
    #[must_use]
    pub fn name_of(&self, index: usize) -> &str {
        let span = self.spans.iter().find(|span| span.var == index);
        span.map_or("", |span| &span.name)
    }

    /// The parameters as arrays named `PREFIX` + name.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn to_arrays(&self, prefix: &str) -> Result<NamedArrays, PolicyError> {
        let mut arrays = NamedArrays::new();
        for (index, var) in self.vars.iter().enumerate() {
            let flat = var.as_tensor().flatten_all()?.to_vec1::<f32>()?;
            for span in self.spans.iter().filter(|span| span.var == index) {
                let (shape, data) = (span.shape.clone(), flat[span.range.clone()].to_vec());
                arrays.insert(format!("{prefix}{}", span.name), Array::F32 { shape, data });
            }
        }
        Ok(arrays)
    }

    /// Sets the parameters from the arrays named `PREFIX` + name.
    ///
    /// # Errors
    /// Names an array that is missing, unknown under the prefix, or of another shape or type. No
    /// parameter has then changed.
    pub fn load(&self, prefix: &str, arrays: &NamedArrays) -> Result<(), PolicyError> {
        let known = |name: &str| self.spans.iter().any(|span| span.name == name);
        let extra = arrays.keys().filter_map(|name| name.strip_prefix(prefix)).find(|n| !known(n));
        if let Some(name) = extra {
            return Err(PolicyError::Restore(format!("{prefix}{name} belongs to no parameter")));
        }
        let parts = self
            .spans
            .iter()
            .map(|span| stored(arrays, prefix, span))
            .collect::<Result<Vec<_>, _>>()?;
        for (index, var) in self.vars.iter().enumerate() {
            let own = self.spans.iter().zip(&parts).filter(|(span, _)| span.var == index);
            let flat: Vec<f32> = own.flat_map(|(_, part)| *part).copied().collect();
            var.set(&Tensor::from_vec(flat, var.dims(), &Device::Cpu)?)?;
        }
        Ok(())
    }
}

/// The elements of the array of one parameter.
fn stored<'a>(
    arrays: &'a NamedArrays,
    prefix: &str,
    span: &TensorSpan,
) -> Result<&'a [f32], PolicyError> {
    let name = format!("{prefix}{}", span.name);
    match arrays.get(&name) {
        Some(Array::F32 { shape, data }) if *shape == span.shape => Ok(data),
        Some(other) => {
            let (found, expected) = (other.shape(), &span.shape);
            let detail = format!("{name} has shape {found:?}, expected {expected:?} F32");
            Err(PolicyError::Restore(detail))
        }
        None => Err(PolicyError::Restore(format!("{name} is missing"))),
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
        let names: Vec<String> =
            parameters().spans().iter().map(|span| span.name.clone()).collect();
        assert_eq!(names, ["z", "a"]);
        assert_eq!(parameters().vars().len(), 2);
    }

    #[test]
    fn loading_is_strict_and_an_error_names_the_array() {
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
