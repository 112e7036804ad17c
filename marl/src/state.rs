//! State that is stored in checkpoints. A type names its arrays once, in a visit that saves or restores them.

use std::collections::BTreeSet;

use policy::arrays::{Array, NamedArrays};
use policy::parameters::{Parameters, TensorSpan};

use crate::error::MarlError;

/// The elements of an array, row-major.
pub enum Elements<'a> {
    /// 32-bit floats.
    F32(&'a mut Vec<f32>),
    /// 64-bit floats.
    F64(&'a mut Vec<f64>),
    /// 64-bit integers.
    I64(&'a mut Vec<i64>),
    /// Bytes.
    U8(&'a mut Vec<u8>),
}

/// The shape of an array.
#[derive(Clone, Copy)]
pub enum ArrayShape<'a> {
    /// The length of every axis.
    Fixed(&'a [usize]),
    /// Any number of rows, each with one axis less.
    Rows(&'a [usize]),
}

/// What is done with the arrays of a state: saving or restoring.
pub trait Visitor {
    /// Saves the elements of the array `name`, or replaces them by the stored ones.
    ///
    /// # Errors
    /// If there is no stored array of this name, or one of another shape or type.
    fn array(
        &mut self,
        name: &str,
        shape: ArrayShape<'_>,
        elements: Elements<'_>,
    ) -> Result<(), MarlError>;
}

/// A state that is stored in checkpoints.
pub trait StoredState {
    /// Prefixes of the names of its arrays.
    fn prefixes(&self) -> &'static [&'static str];

    /// Visits all of its arrays, in any order.
    ///
    /// # Errors
    /// Passes on the visitor's; names an array with invalid elements; if a tensor operation fails.
    fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError>;

    /// All of its arrays.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn arrays(&mut self) -> Result<NamedArrays, MarlError> {
        self.arrays_under("")
    }

    /// Its arrays whose names begin with `prefix`.
    ///
    /// # Errors
    /// If a tensor operation fails.
    fn arrays_under(&mut self, prefix: &'static str) -> Result<NamedArrays, MarlError> {
        saved(prefix, |visitor| self.visit(visitor))
    }

    /// Restores the output of [`StoredState::arrays`]. Arrays under other prefixes are ignored. After an error the state is
    /// unspecified.
    ///
    /// # Errors
    /// Names an array that is missing, unknown, invalid, or of another shape or type.
    fn restore(&mut self, arrays: &NamedArrays) -> Result<(), MarlError> {
        let known = restored(arrays, |visitor| self.visit(visitor))?;
        let own = |name: &&String| self.prefixes().iter().any(|prefix| name.starts_with(prefix));
        match arrays.keys().filter(own).find(|name| !known.contains(*name)) {
            None => Ok(()),
            Some(name) => Err(MarlError::Restore(format!("{name} does not belong to this run"))),
        }
    }
}

/// The arrays of a visit whose names begin with `prefix`.
pub(crate) fn saved(
    prefix: &'static str,
    visit: impl FnOnce(&mut dyn Visitor) -> Result<(), MarlError>,
) -> Result<NamedArrays, MarlError> {
    let mut saved = Saved { prefix, arrays: NamedArrays::new() };
    visit(&mut saved)?;
    Ok(saved.arrays)
}

/// Restores the arrays of a visit. Returns their names.
pub(crate) fn restored(
    arrays: &NamedArrays,
    visit: impl FnOnce(&mut dyn Visitor) -> Result<(), MarlError>,
) -> Result<BTreeSet<String>, MarlError> {
    let mut restored = Restored { arrays, names: BTreeSet::new() };
    visit(&mut restored)?;
    Ok(restored.names)
}

/// Collects the arrays whose names begin with `prefix`.
struct Saved {
    prefix: &'static str,
    arrays: NamedArrays,
}

impl Visitor for Saved {
    fn array(
        &mut self,
        name: &str,
        shape: ArrayShape<'_>,
        elements: Elements<'_>,
    ) -> Result<(), MarlError> {
        if name.starts_with(self.prefix) {
            let shape = shape.with(elements.count());
            let array = match elements {
                Elements::F32(data) => Array::F32 { shape, data: data.clone() },
                Elements::F64(data) => Array::F64 { shape, data: data.clone() },
                Elements::I64(data) => Array::I64 { shape, data: data.clone() },
                Elements::U8(data) => Array::U8 { shape, data: data.clone() },
            };
            self.arrays.insert(name.to_owned(), array);
        }
        Ok(())
    }
}

/// Replaces elements by those of stored arrays, and keeps the arrays' names.
struct Restored<'a> {
    arrays: &'a NamedArrays,
    names: BTreeSet<String>,
}

impl Visitor for Restored<'_> {
    fn array(
        &mut self,
        name: &str,
        shape: ArrayShape<'_>,
        elements: Elements<'_>,
    ) -> Result<(), MarlError> {
        let stored = self.arrays.get(name);
        let stored = stored.ok_or_else(|| MarlError::Restore(format!("{name} is missing")))?;
        let fits = shape.admits(stored.shape());
        let expected = format!("{} {}", shape.text(), elements.name());
        match (elements, stored) {
            (Elements::F32(own), Array::F32 { data, .. }) if fits => own.clone_from(data),
            (Elements::F64(own), Array::F64 { data, .. }) if fits => own.clone_from(data),
            (Elements::I64(own), Array::I64 { data, .. }) if fits => own.clone_from(data),
            (Elements::U8(own), Array::U8 { data, .. }) if fits => own.clone_from(data),
            _ => {
                let found = format!("{:?} {:?}", stored.shape(), stored.dtype());
                let detail = format!("{name} has shape {found}, expected {expected}");
                return Err(MarlError::Restore(detail));
            }
        }
        self.names.insert(name.to_owned());
        Ok(())
    }
}

impl Elements<'_> {
    fn count(&self) -> usize {
        match self {
            Self::F32(data) => data.len(),
            Self::F64(data) => data.len(),
            Self::I64(data) => data.len(),
            Self::U8(data) => data.len(),
        }
    }

    fn name(&self) -> &'static str {
        match self {
            Self::F32(_) => "F32",
            Self::F64(_) => "F64",
            Self::I64(_) => "I64",
            Self::U8(_) => "U8",
        }
    }
}

impl ArrayShape<'_> {
    /// The shape of `count` elements.
    fn with(self, count: usize) -> Vec<usize> {
        match self {
            Self::Fixed(shape) => shape.to_vec(),
            Self::Rows(row) => [&[count / row.iter().product::<usize>()], row].concat(),
        }
    }

    fn admits(self, found: &[usize]) -> bool {
        match self {
            Self::Fixed(shape) => found == shape,
            Self::Rows(row) => found.split_first().is_some_and(|(_, found)| found == row),
        }
    }

    fn text(self) -> String {
        match self {
            Self::Fixed(shape) => format!("{shape:?}"),
            Self::Rows(row) => {
                let axes = row.iter().map(|axis| format!(", {axis}")).collect::<String>();
                format!("[any{axes}]")
            }
        }
    }
}

/// Visits the array `name` of `count` numbers.
pub(crate) fn visit_numbers(
    visitor: &mut dyn Visitor,
    name: &str,
    numbers: &mut Vec<f64>,
) -> Result<(), MarlError> {
    let shape = [numbers.len()];
    visitor.array(name, ArrayShape::Fixed(&shape), Elements::F64(numbers))
}

/// Visits a number as an array of one element.
pub(crate) fn visit_number(
    visitor: &mut dyn Visitor,
    name: &str,
    number: &mut f64,
) -> Result<(), MarlError> {
    let mut numbers = vec![*number];
    visit_numbers(visitor, name, &mut numbers)?;
    *number = numbers[0];
    Ok(())
}

/// Visits a count as an array of one element.
pub(crate) fn visit_count(
    visitor: &mut dyn Visitor,
    name: &str,
    count: &mut i64,
) -> Result<(), MarlError> {
    let mut counts = vec![*count];
    visitor.array(name, ArrayShape::Fixed(&[1]), Elements::I64(&mut counts))?;
    if counts[0] < 0 {
        return Err(MarlError::Restore(format!("{name} is {}, expected a count", counts[0])));
    }
    *count = counts[0];
    Ok(())
}

/// Visits one array per parameter, `PREFIX` + name; `values` are the elements of every variable.
pub(crate) fn visit_spans(
    visitor: &mut dyn Visitor,
    prefix: &str,
    spans: &[TensorSpan],
    values: &mut [Vec<f32>],
) -> Result<(), MarlError> {
    for span in spans {
        let own = &mut values[span.var][span.range.clone()];
        let name = format!("{prefix}{}", span.name);
        let mut part = own.to_vec();
        visitor.array(&name, ArrayShape::Fixed(&span.shape), Elements::F32(&mut part))?;
        own.copy_from_slice(&part);
    }
    Ok(())
}

/// Visits a network's parameters, `PREFIX` + name.
pub(crate) fn visit_parameters(
    visitor: &mut dyn Visitor,
    prefix: &str,
    parameters: &Parameters,
) -> Result<(), MarlError> {
    let mut values = parameters.values()?;
    visit_spans(visitor, prefix, parameters.spans(), &mut values)?;
    Ok(parameters.set(values)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Two {
        pair: Vec<f32>,
        rows: Vec<i64>,
    }

    impl StoredState for Two {
        fn prefixes(&self) -> &'static [&'static str] {
            &["x/"]
        }

        fn visit(&mut self, visitor: &mut dyn Visitor) -> Result<(), MarlError> {
            visitor.array("x/pair", ArrayShape::Fixed(&[2]), Elements::F32(&mut self.pair))?;
            visitor.array("x/rows", ArrayShape::Rows(&[3]), Elements::I64(&mut self.rows))
        }
    }

    fn stored() -> NamedArrays {
        Two { pair: vec![1.0, 2.0], rows: vec![0, 1, 2, 3, 4, 5] }.arrays().unwrap()
    }

    #[test]
    fn arrays_have_their_shapes_and_are_restored_beside_those_of_others() {
        let mut arrays = stored();
        assert_eq!((arrays["x/pair"].shape(), arrays["x/rows"].shape()), (&[2][..], &[2, 3][..]));
        arrays.insert("y/other".to_owned(), arrays["x/pair"].clone());
        let mut two = Two::default();
        two.restore(&arrays).unwrap();
        assert_eq!(two.arrays().unwrap(), stored());
    }

    #[test]
    fn arrays_that_are_missing_unknown_or_of_another_shape_or_type_are_named() {
        let ints = |shape: Vec<usize>| Array::I64 { data: vec![0; shape.iter().product()], shape };
        for (name, array, expected) in [
            ("x/pair", None, "x/pair is missing"),
            ("x/more", Some(ints(vec![1])), "x/more does not belong to this run"),
            ("x/pair", Some(ints(vec![2])), "x/pair has shape [2] I64, expected [2] F32"),
            (
                "x/rows",
                Some(ints(vec![2, 4])),
                "x/rows has shape [2, 4] I64, expected [any, 3] I64",
            ),
        ] {
            let mut arrays = stored();
            arrays.remove(name);
            arrays.extend(array.map(|array| (name.to_owned(), array)));
            let error = Two::default().restore(&arrays).unwrap_err().to_string();
            assert_eq!(error, format!("stored state: {expected}"));
        }
    }
}
