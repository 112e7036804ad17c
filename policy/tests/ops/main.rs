//! Fused networks against their references in double precision.
#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod plain;

use candle_core::{DType, Device, Tensor, Var};
use policy::Parameters;
use policy::layers::{LayerSpec, network_of};
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
fn stack(specs: &[LayerSpec]) -> (Parameters, LayerStack) {
    let mut parameters = Parameters::new();
    let mut rng = generator(RunSeed(1), Draw::of(Purpose::Initialisation));
    let stack = LayerStack::declare(&mut parameters, specs, &mut rng).unwrap();
    let var = &parameters.vars()[0];
    let moved = single((normal(8, var.dims()) * 0.3).unwrap());
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

fn single(tensor: Tensor) -> Tensor {
    tensor.to_dtype(DType::F32).unwrap()
}

fn double(tensor: &Tensor) -> Tensor {
    tensor.to_dtype(DType::F64).unwrap()
}

/// A scalar that weighs every output differently.
fn scalar(y: &Tensor) -> Tensor {
    (y * normal(99, y.dims()).to_dtype(y.dtype()).unwrap()).unwrap().sum_all().unwrap()
}

/// Output, gradient of the parameters and gradient of the input of [`scalar`], in double precision.
fn results(y: &Tensor, parameters: &Var, x: &Var) -> [Tensor; 3] {
    let gradients = Backward::from(&scalar(y)).unwrap();
    let by = |var: &Var| double(&gradients.by(var).unwrap().unwrap());
    [double(y), by(parameters), by(x)]
}

fn largest(tensor: &Tensor) -> f64 {
    tensor.abs().unwrap().max_all().unwrap().to_scalar::<f64>().unwrap()
}

#[test]
fn fused_networks_are_within_a_few_millionths_of_their_twins_in_double_precision() {
    for (specs, inputs) in networks() {
        let (parameters, stack) = stack(&specs);
        let input = normal(2, &[ROWS, inputs]);
        let start = normal(3, &[SEQUENCES, 18]);
        let mask = mask();
        let x = Var::from_tensor(&input).unwrap();
        let twin = Var::from_tensor(&double(&parameters.vars()[0])).unwrap();
        let recurrent = Some(RecurrentInput { start: &start, mask: &mask });
        let y = plain::network(&network_of(&specs), &x, &twin, recurrent).unwrap();
        let expected = results(&y, &twin, &x);
        let x = Var::from_tensor(&single(input)).unwrap();
        let (start, mask) = (single(start), single(mask));
        let recurrent = Some(RecurrentInput { start: &start, mask: &mask });
        let y = stack.weights().unwrap().apply(&x, recurrent).unwrap();
        let found = results(&y, &parameters.vars()[0], &x);
        for (found, expected) in found.iter().zip(&expected) {
            let off = largest(&(found - expected).unwrap()) / largest(expected);
            assert!(off < 5e-6, "{specs:?}: off by {off}");
        }
    }
}

#[test]
fn constant_weights_give_the_same_gradient_by_the_input_and_none_by_the_parameters() {
    let (specs, inputs) = networks().remove(0);
    let (parameters, stack) = stack(&specs);
    let x = single(normal(2, &[ROWS, inputs]));
    let x = Var::from_tensor(&x).unwrap();
    let gradients = |weights: ops::Weights| {
        Backward::from(&weights.apply(&x, None).unwrap().sum_all().unwrap()).unwrap()
    };
    let all = gradients(stack.weights().unwrap());
    let own = gradients(stack.constant_weights().unwrap());
    let by = |gradients: &Backward, var: &Var| gradients.by(var).unwrap();
    let numbers = |found: Option<Tensor>| found.unwrap().to_vec2::<f32>().unwrap();
    assert_eq!(numbers(by(&own, &x)), numbers(by(&all, &x)));
    assert!(by(&all, &parameters.vars()[0]).is_some());
    assert!(by(&own, &parameters.vars()[0]).is_none());
}

#[test]
fn a_network_that_is_used_twice_has_the_sum_of_both_gradients() {
    let (specs, inputs) = networks().remove(0);
    let (parameters, stack) = stack(&specs);
    let weights = stack.weights().unwrap();
    let sum_of = |seed| {
        let x = single(normal(seed, &[ROWS, inputs]));
        weights.apply(&x, None).unwrap().sum_all().unwrap()
    };
    let by = |root: Tensor| {
        let gradient = Backward::from(&root).unwrap().by(&parameters.vars()[0]).unwrap().unwrap();
        double(&gradient)
    };
    let apart = (by(sum_of(1)) + by(sum_of(2))).unwrap();
    let together = by((sum_of(1) + sum_of(2)).unwrap());
    assert!(largest(&(&together - &apart).unwrap()) < 1e-5 * largest(&apart));
}

#[test]
fn the_sigmoid_and_its_slope_are_within_a_millionth_of_the_reference() {
    let slope = |x: &Var, y: &Tensor| {
        let gradients = Backward::from(&y.sum_all().unwrap()).unwrap();
        double(&gradients.by(x).unwrap().unwrap())
    };
    let (one, two) = (normal(1, &[11]), single(normal(1, &[11])));
    let (one, two) = (Var::from_tensor(&one).unwrap(), Var::from_tensor(&two).unwrap());
    let expected = candle_nn::ops::sigmoid(&one).unwrap();
    let found = ops::sigmoid(&two).unwrap();
    assert!(largest(&(double(&found) - &expected).unwrap()) < 1e-6);
    assert!(largest(&(slope(&two, &found) - slope(&one, &expected)).unwrap()) < 1e-6);
}

#[test]
fn rows_states_and_masks_that_do_not_fit_are_refused() {
    let (specs, _) = networks().remove(2);
    let (_, stack) = stack(&specs);
    let weights = stack.weights().unwrap();
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
