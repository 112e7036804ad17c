//! A network's named parameters.

use core::ops::Range;

use candle_core::{Device, Tensor, Var};

use crate::arrays::{Array, NamedArrays};
use crate::error::PolicyError;

/// Named parameters in the order of their declaration. Clones share their values.
#[derive(Clone, Debug, Default)]
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
    pub(crate) fn add_all(
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

    /// The elements of every variable, in order.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub fn values(&self) -> Result<Vec<Vec<f32>>, PolicyError> {
        let one = |var: &Var| Ok(var.as_tensor().flatten_all()?.to_vec1()?);
        self.vars.iter().map(one).collect()
    }

    /// Sets the elements of every variable.
    ///
    /// # Errors
    /// If the number of variables or of elements is wrong.
    pub fn set(&self, values: Vec<Vec<f32>>) -> Result<(), PolicyError> {
        let given = values.len();
        let wanted = self.vars.len();
        if given != wanted {
            return Err(PolicyError::Restore(format!("{given} variables, expected {wanted}")));
        }
        for (var, values) in self.vars.iter().zip(values) {
            var.set(&Tensor::from_vec(values, var.shape(), &Device::Cpu)?)?;
        }
        Ok(())
    }

    /// The parameters as arrays.
    ///
    /// # Errors
    /// Passes on a tensor error.
    pub(crate) fn to_arrays(&self) -> Result<NamedArrays, PolicyError> {
        let values = self.values()?;
        let one = |span: &TensorSpan| {
            let shape = span.shape.clone();
            let data = values[span.var][span.range.clone()].to_vec();
            (span.name.clone(), Array::F32 { shape, data })
        };
        Ok(self.spans.iter().map(one).collect())
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
    fn values_are_set_in_the_order_of_declaration_and_become_arrays_with_their_names() {
        let target = parameters();
        target.set(vec![vec![5.0, 6.0], vec![7.0, 8.0]]).expect("two numbers each");
        let one = |data: Vec<f32>| Array::F32 { shape: vec![2], data };
        let expected =
            [("z".to_owned(), one(vec![5.0, 6.0])), ("a".to_owned(), one(vec![7.0, 8.0]))];
        assert_eq!(target.to_arrays().expect("f32"), NamedArrays::from(expected));
        assert!(target.set(vec![vec![5.0], vec![7.0, 8.0]]).is_err());
        assert!(target.set(vec![vec![5.0, 6.0]]).is_err());
        assert!(target.set(vec![vec![5.0, 6.0]; 3]).is_err());
    }
}
