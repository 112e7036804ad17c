//! Fused networks against their references in double precision, and these against finite differences.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use candle_core::{DType, Device, Result, Tensor};
use policy::Parameters;
use policy::layers::LayerSpec;
use policy::ops::{self, Activation, Backward, LayerStack, RecurrentInput};
use policy::randomness::{Draw, Purpose, RunSeed, generator, standard_normal};

const STEPS: usize = 5;
const SEQUENCES: usize = 7;
const ROWS: usize = STEPS * SEQUENCES;

fn normal(seed: u64, shape: &[usize]) -> Tensor {
    let mut rng = generator(RunSeed(seed), Draw::of(Purpose::Probe));
    let count = shape.iter().product();
    let data: Vec<f64> = (0..count).map(|_| f64::from(standard_normal(&mut rng))).collect();
    Tensor::from_vec(data, shape, &Device::Cpu).unwrap()
}

/// A network of these layers with random parameters, including biases.
fn stack(specs: &[LayerSpec], dtype: DType) -> (Parameters, LayerStack) {
    let mut parameters = Parameters::new();
    let mut rng = generator(RunSeed(1), Draw::of(Purpose::Initialisation));
    let stack = LayerStack::declare(&mut parameters, specs, dtype, &mut rng).unwrap();
    let var = &parameters.vars()[0];
    let moved = (normal(8, var.dims()) * 0.3).unwrap().to_dtype(dtype).unwrap();
    var.set(&(var.as_tensor() + moved).unwrap()).unwrap();
    (parameters, stack)
}

/// Networks of all kinds of layers, with and without a norm at the input, with sizes that do not fill registers.
fn networks() -> Vec<(Vec<LayerSpec>, usize)> {
    let linear = |name: &str, shape, activation| LayerSpec::linear(name, shape, activation, 1.0);
    let mlp = |first: Vec<LayerSpec>, inputs: usize| {
        let rest = [
            linear("a", (inputs, 33), Activation::Relu),
            LayerSpec::norm("b", 33),
            linear("c", (33, 16), Activation::Tanh),
            linear("d", (16, 3), Activation::Identity),
        ];
        [first, rest.to_vec()].concat()
    };
    let gru = vec![
        LayerSpec::norm("n", 9),
        linear("e", (9, 20), Activation::Tanh),
        LayerSpec::gru("gru", 20, 18),
        LayerSpec::norm("o", 18),
        linear("h", (18, 2), Activation::Identity),
    ];
    vec![(mlp(vec![LayerSpec::norm("n", 5)], 5), 5), (mlp(vec![], 17), 17), (gru, 9)]
}

/// Resets in the middle of sequences.
fn mask() -> Tensor {
    let mut mask = vec![1.0_f64; ROWS];
    for reset in [0, 6, 13, 14, 22] {
        mask[reset] = 0.0;
    }
    Tensor::from_vec(mask, (STEPS, SEQUENCES), &Device::Cpu).unwrap()
}

/// Output, gradient of the parameters and gradient of the input in double precision, from a pass in `dtype`. The scalar
/// at its root weighs every output differently.
fn pass(specs: &[LayerSpec], inputs: usize, dtype: DType) -> Result<[Tensor; 3]> {
    let (parameters, stack) = stack(specs, dtype);
    let x = candle_core::Var::from_tensor(&normal(2, &[ROWS, inputs]).to_dtype(dtype)?)?;
    let start = normal(3, &[SEQUENCES, 18]).to_dtype(dtype)?;
    let mask = mask().to_dtype(dtype)?;
    let recurrent = Some(RecurrentInput { start: &start, mask: &mask });
    let y = stack.weights()?.apply(&x, recurrent)?;
    let gradients = Backward::from(&(&y * normal(99, y.dims()).to_dtype(dtype)?)?.sum_all()?)?;
    let by = |var: &candle_core::Var| gradients.by(var).unwrap().unwrap();
    let found = [y, by(&parameters.vars()[0]), by(&x)];
    let [y, by_parameters, by_x] = found.map(|tensor| tensor.to_dtype(DType::F64).unwrap());
    Ok([y, by_parameters, by_x])
}

fn largest(tensor: &Tensor) -> f64 {
    tensor.abs().unwrap().max_all().unwrap().to_scalar::<f64>().unwrap()
}

#[test]
fn fused_networks_are_within_a_few_millionths_of_their_twins_in_double_precision() {
    for (specs, inputs) in networks() {
        let fused = pass(&specs, inputs, DType::F32).unwrap();
        let twin = pass(&specs, inputs, DType::F64).unwrap();
        for (found, expected) in fused.iter().zip(&twin) {
            let off = largest(&(found - expected).unwrap()) / largest(expected);
            assert!(off < 5e-6, "{specs:?}: off by {off}");
        }
    }
}

#[test]
fn the_states_after_every_row_are_those_of_the_twin_and_come_with_the_output_of_a_pass() {
    let (specs, inputs) = networks().remove(2);
    let pass = |dtype| {
        let (_parameters, stack) = stack(&specs, dtype);
        let converted = |tensor: Tensor| tensor.to_dtype(dtype).unwrap();
        let (x, start) =
            (converted(normal(2, &[ROWS, inputs])), converted(normal(3, &[SEQUENCES, 18])));
        let mask = converted(mask());
        let recurrent = RecurrentInput { start: &start, mask: &mask };
        let weights = stack.weights().unwrap();
        let (states, output) = weights.states_and_output(&x, recurrent).unwrap();
        assert_eq!((states.dims(), output.dims()), (&[ROWS, 18][..], &[ROWS, 2][..]));
        let numbers =
            |tensor: Tensor| tensor.to_dtype(DType::F64).unwrap().to_vec2::<f64>().unwrap();
        let alone = weights.apply(&x, Some(recurrent)).unwrap();
        assert_eq!(numbers(output), numbers(alone));
        let last = weights.last_states(&x, recurrent).unwrap().unwrap();
        assert_eq!(numbers(states.clone())[ROWS - SEQUENCES..], numbers(last));
        states.to_dtype(DType::F64).unwrap()
    };
    let (fused, twin) = (pass(DType::F32), pass(DType::F64));
    let off = largest(&(fused - &twin).unwrap()) / largest(&twin);
    assert!(off < 5e-6, "off by {off}");
}

#[test]
fn gradients_of_the_twins_meet_finite_differences() {
    for (specs, inputs) in networks() {
        let (parameters, stack) = stack(&specs, DType::F64);
        let (x, start, mask) = (normal(2, &[ROWS, inputs]), normal(3, &[SEQUENCES, 18]), mask());
        let recurrent = Some(RecurrentInput { start: &start, mask: &mask });
        let [_, found, _] = pass(&specs, inputs, DType::F64).unwrap();
        let var = &parameters.vars()[0];
        let (at, direction) = (var.as_tensor().copy().unwrap(), normal(7, var.dims()));
        let value = |step: f64| {
            var.set(&(&at + (&direction * step).unwrap()).unwrap()).unwrap();
            let y = stack.weights().unwrap().apply(&x, recurrent).unwrap();
            let scalar = (&y * normal(99, y.dims())).unwrap().sum_all().unwrap();
            scalar.to_scalar::<f64>().unwrap()
        };
        let slope = (value(1e-6) - value(-1e-6)) / 2e-6;
        let expected = (found * &direction).unwrap().sum_all().unwrap().to_scalar::<f64>().unwrap();
        assert!((slope - expected).abs() < 1e-5 * expected.abs().max(1.0), "{slope} {expected}");
    }
}

#[test]
fn constant_weights_give_the_same_gradient_by_the_input_and_none_by_the_parameters() {
    let (specs, inputs) = networks().remove(0);
    let (parameters, stack) = stack(&specs, DType::F32);
    let x = normal(2, &[ROWS, inputs]).to_dtype(DType::F32).unwrap();
    let x = candle_core::Var::from_tensor(&x).unwrap();
    let gradients = |weights: ops::Weights| {
        Backward::from(&weights.apply(&x, None).unwrap().sum_all().unwrap()).unwrap()
    };
    let all = gradients(stack.weights().unwrap());
    let own = gradients(stack.constant_weights().unwrap());
    let by = |gradients: &Backward, var: &candle_core::Var| gradients.by(var).unwrap();
    let numbers = |found: Option<Tensor>| found.unwrap().to_vec2::<f32>().unwrap();
    assert_eq!(numbers(by(&own, &x)), numbers(by(&all, &x)));
    assert!(by(&all, &parameters.vars()[0]).is_some());
    assert!(by(&own, &parameters.vars()[0]).is_none());
}

#[test]
fn a_network_that_is_used_twice_has_the_sum_of_both_gradients() {
    let (specs, inputs) = networks().remove(0);
    let (parameters, stack) = stack(&specs, DType::F32);
    let weights = stack.weights().unwrap();
    let sum_of = |seed| {
        let x = normal(seed, &[ROWS, inputs]).to_dtype(DType::F32).unwrap();
        weights.apply(&x, None).unwrap().sum_all().unwrap()
    };
    let by = |root: Tensor| {
        let gradient = Backward::from(&root).unwrap().by(&parameters.vars()[0]).unwrap().unwrap();
        gradient.to_dtype(DType::F64).unwrap()
    };
    let apart = (by(sum_of(1)) + by(sum_of(2))).unwrap();
    let together = by((sum_of(1) + sum_of(2)).unwrap());
    assert!(largest(&(&together - &apart).unwrap()) < 1e-5 * largest(&apart));
}

#[test]
fn features_and_output_are_those_of_the_differentiable_pass() {
    for dtype in [DType::F32, DType::F64] {
        let (specs, inputs) = networks().remove(1);
        let (_, stack) = stack(&specs, dtype);
        let x = normal(2, &[ROWS, inputs]).to_dtype(dtype).unwrap();
        let weights = stack.weights().unwrap();
        let (features, output) = weights.features_and_output(&x, None).unwrap();
        let difference = (&output - weights.apply(&x, None).unwrap()).unwrap();
        assert_eq!(largest(&difference.to_dtype(DType::F64).unwrap()), 0.0);
        assert_eq!((features.dims(), output.dims()), (&[ROWS, 16][..], &[ROWS, 3][..]));
    }
}

#[test]
fn the_sigmoid_equals_candles() {
    let x = normal(1, &[11]);
    let difference = (ops::sigmoid(&x).unwrap() - candle_nn::ops::sigmoid(&x).unwrap()).unwrap();
    assert!(largest(&difference) < 1e-15);
}

#[test]
fn rows_states_and_masks_that_do_not_fit_are_refused() {
    let (specs, _) = networks().remove(2);
    let (_, stack) = stack(&specs, DType::F32);
    let weights = stack.weights().unwrap();
    let single = |tensor: Tensor| tensor.to_dtype(DType::F32).unwrap();
    let (start, mask) = (single(normal(3, &[SEQUENCES, 18])), single(mask()));
    let fits = Some(RecurrentInput { start: &start, mask: &mask });
    assert!(weights.apply(&single(normal(1, &[ROWS, 9])), fits).is_ok());
    assert!(weights.apply(&single(normal(1, &[ROWS, 8])), fits).is_err());
    assert!(weights.apply(&single(normal(1, &[ROWS - 1, 9])), fits).is_err());
    assert!(weights.apply(&normal(1, &[ROWS, 9]), fits).is_err());
    assert!(weights.apply(&single(normal(1, &[ROWS, 9])), None).is_err());
    let narrow = single(normal(3, &[SEQUENCES, 17]));
    let wrong = Some(RecurrentInput { start: &narrow, mask: &mask });
    assert!(weights.apply(&single(normal(1, &[ROWS, 9])), wrong).is_err());
}
