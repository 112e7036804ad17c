//! Finite differences of losses whose networks compute in single precision.

use candle_core::{Device, Tensor, Var};

/// Compares the slopes of `loss` by some elements of `var` with `gradient`, and returns how many exceed `tolerance` in
/// magnitude. The difference quotient has the fourth order, so that its step can be large compared with
/// the rounding errors of single precision.
pub(crate) fn meets_finite_differences(
    loss: &dyn Fn() -> f64,
    (var, gradient): (&Var, &[f32]),
    elements: impl Iterator<Item = usize>,
    (step, tolerance): (f32, f64),
) -> usize {
    let start = var.as_tensor().flatten_all().unwrap().to_vec1::<f32>().unwrap();
    assert_eq!(start.len(), gradient.len());
    let set = |values: Vec<f32>| {
        var.set(&Tensor::from_vec(values, var.shape(), &Device::Cpu).unwrap()).unwrap();
    };
    let mut significant = 0;
    for at in elements {
        let difference = |by: f32| {
            let [above, below] = [by, -by].map(|by| {
                let mut values = start.clone();
                values[at] += by;
                let moved = f64::from(values[at]);
                set(values);
                (moved, loss())
            });
            (above.1 - below.1) / (above.0 - below.0)
        };
        let slope = (4.0 * difference(step) - difference(2.0 * step)) / 3.0;
        let found = f64::from(gradient[at]);
        let error = (slope - found).abs();
        assert!(error < tolerance * (1.0 + slope.abs()), "element {at}: {slope} {found}");
        significant += usize::from(found.abs() > tolerance);
    }
    set(start);
    significant
}
