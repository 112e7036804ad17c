//! The fused operations against their plain twins and against finite differences, in f64.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use candle_core::{DType, Device, Result, Tensor, Var};
use policy::ops::{self, Activation, plain};
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};

fn normal(seed: u64, shape: &[usize]) -> Tensor {
    let mut rng = generator(RunSeed(seed), Draw::of(Purpose::Probe));
    let count = shape.iter().product();
    let data: Vec<f64> = (0..count).map(|_| f64::from(standard_normal(&mut rng))).collect();
    Tensor::from_vec(data, shape, &Device::Cpu).unwrap()
}

fn var(seed: u64, shape: &[usize]) -> Var {
    Var::from_tensor(&normal(seed, shape)).unwrap()
}

/// A scalar that weighs every element of `y` differently.
fn scalar(y: &Tensor) -> Result<Tensor> {
    (y * normal(99, y.dims()))?.sum_all()
}

fn difference(a: &Tensor, b: &Tensor) -> f64 {
    let scale = b.abs().unwrap().max_all().unwrap().to_scalar::<f64>().unwrap().max(1e-9);
    (a - b).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f64>().unwrap() / scale
}

/// Values and gradients of `fused` and `twin` agree to 1e-12, and gradients meet finite differences.
fn assert_twins(
    vars: &[Var],
    fused: impl Fn(&[Tensor]) -> Result<Tensor>,
    twin: impl Fn(&[Tensor]) -> Result<Tensor>,
) {
    let inputs: Vec<Tensor> = vars.iter().map(|var| var.as_tensor().clone()).collect();
    let (y, expected) = (fused(&inputs).unwrap(), twin(&inputs).unwrap());
    assert!(difference(&y, &expected) < 1e-12, "values differ");
    let (own, other) =
        (scalar(&y).unwrap().backward().unwrap(), scalar(&expected).unwrap().backward().unwrap());
    for (index, var) in vars.iter().enumerate() {
        let gradient = own.get(var).unwrap_or_else(|| panic!("no gradient by input {index}"));
        let off = difference(gradient, other.get(var).unwrap());
        assert!(off < 1e-12, "gradient by input {index} is off by {off}");
        assert_finite_difference(&inputs, index, gradient, &fused);
    }
}

fn assert_finite_difference(
    inputs: &[Tensor],
    index: usize,
    gradient: &Tensor,
    f: &impl Fn(&[Tensor]) -> Result<Tensor>,
) {
    let direction = normal(7 + index as u64, inputs[index].dims());
    let at = |step: f64| {
        let mut moved = inputs.to_vec();
        moved[index] = (&inputs[index] + (&direction * step).unwrap()).unwrap();
        scalar(&f(&moved).unwrap()).unwrap().to_scalar::<f64>().unwrap()
    };
    let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
    let expected = (gradient * &direction).unwrap().sum_all().unwrap().to_scalar::<f64>().unwrap();
    assert!(
        (slope - expected).abs() < 1e-6 * expected.abs().max(1.0),
        "input {index}: {slope} {expected}"
    );
}

#[test]
fn a_linear_layer_with_constant_weights_gives_the_same_gradient_by_its_input_and_no_other() {
    let (x, w, b) = (var(1, &[7, 5]), var(2, &[3, 5]), var(3, &[3]));
    let gradients = |w: &Tensor, b: &Tensor| {
        let y = ops::linear(&x, w, b, Activation::Relu).unwrap();
        scalar(&y).unwrap().backward().unwrap()
    };
    let constants = (w.detach(), b.detach());
    let (all, own) = (gradients(&w, &b), gradients(&constants.0, &constants.1));
    let numbers = |tensor: Option<&Tensor>| tensor.unwrap().to_vec2::<f64>().unwrap();
    assert_eq!(numbers(own.get(&x)), numbers(all.get(&x)));
    assert!(all.get(&w).is_some() && all.get(&b).is_some());
    assert!(own.get(&constants.0).is_none() && own.get(&constants.1).is_none());
}

#[test]
fn a_linear_layer_equals_its_twin_with_every_activation() {
    let vars = [var(1, &[7, 5]), var(2, &[3, 5]), var(3, &[3])];
    for activation in [Activation::Identity, Activation::Tanh, Activation::Relu] {
        assert_twins(
            &vars,
            |x| ops::linear(&x[0], &x[1], &x[2], activation),
            |x| plain::linear(&x[0], &x[1], &x[2], activation),
        );
    }
}

#[test]
fn a_constant_input_costs_no_gradient_and_changes_no_other() {
    let (x, w, b) = (normal(1, &[6, 4]), var(2, &[3, 4]), var(3, &[3]));
    let y = ops::linear(&x, &w, &b, Activation::Tanh).unwrap();
    let gradients = scalar(&y).unwrap().backward().unwrap();
    let twin = scalar(&plain::linear(&x, &w, &b, Activation::Tanh).unwrap()).unwrap();
    let expected = twin.backward().unwrap();
    for var in [&w, &b] {
        assert!(difference(gradients.get(var).unwrap(), expected.get(var).unwrap()) < 1e-12);
    }
    assert!(gradients.get(&x).is_none());
}

#[test]
fn layer_normalisation_equals_its_twin() {
    // More rows than are summed side by side, and some that are left over.
    let vars = [var(1, &[19, 9]), var(2, &[9]), var(3, &[9])];
    assert_twins(
        &vars,
        |x| ops::layer_norm(&x[0], &x[1], &x[2]),
        |x| plain::layer_norm(&x[0], &x[1], &x[2]),
    );
}

#[test]
fn a_recurrent_sequence_with_resets_in_its_middle_equals_its_twin() {
    let (steps, sequences, hidden) = (5, 4, 3);
    let vars = [
        var(1, &[steps * sequences, 3 * hidden]),
        var(2, &[3 * hidden, hidden]),
        var(3, &[3 * hidden]),
    ];
    let h0 = normal(4, &[sequences, hidden]);
    let mut mask = vec![1.0_f64; steps * sequences];
    for reset in [0, 6, 13, 14] {
        mask[reset] = 0.0;
    }
    let mask = Tensor::from_vec(mask, (steps, sequences), &Device::Cpu).unwrap();
    assert_twins(
        &vars,
        |x| ops::gru_sequence(&x[0], &x[1], &x[2], &h0, &mask),
        |x| plain::gru_sequence(&x[0], &x[1], &x[2], &h0, &mask),
    );
}

#[test]
fn the_sigmoid_equals_candles() {
    assert_twins(&[var(1, &[11])], |x| ops::sigmoid(&x[0]), |x| candle_nn::ops::sigmoid(&x[0]));
}

#[test]
fn single_precision_stays_within_a_millionth_of_double_precision() {
    let (steps, sequences, hidden) = (10, 8, 16);
    let inputs = [
        normal(1, &[steps * sequences, 3 * hidden]),
        normal(2, &[3 * hidden, hidden]),
        normal(3, &[3 * hidden]),
        normal(4, &[sequences, hidden]),
        Tensor::ones((steps, sequences), DType::F64, &Device::Cpu).unwrap(),
    ];
    let run = |dtype: DType| {
        let x: Vec<Tensor> = inputs.iter().map(|x| x.to_dtype(dtype).unwrap()).collect();
        let y = ops::gru_sequence(&x[0], &x[1], &x[2], &x[3], &x[4]).unwrap();
        y.to_dtype(DType::F64).unwrap()
    };
    assert!(difference(&run(DType::F32), &run(DType::F64)) < 5e-6);
}

#[test]
fn shapes_that_do_not_fit_are_refused() {
    assert!(
        ops::linear(&normal(1, &[2, 3]), &normal(2, &[4, 5]), &normal(3, &[4]), Activation::Tanh)
            .is_err()
    );
    assert!(ops::layer_norm(&normal(1, &[2, 3]), &normal(2, &[4]), &normal(3, &[4])).is_err());
    let gru = ops::gru_sequence(
        &normal(1, &[6, 6]),
        &normal(2, &[6, 2]),
        &normal(3, &[6]),
        &normal(4, &[2, 2]),
        &normal(5, &[2, 2]),
    );
    assert!(gru.is_err());
}
