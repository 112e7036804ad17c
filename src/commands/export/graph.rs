//! A policy's network as an ONNX graph: `observation` and `hidden` in, `action` and `next_hidden` out.
//!
//! `action` is the action of an evaluation: the mean, or the index of the likeliest choice. `output` is the output of
//! the network: means before squashing, or logits. The metadata contains the standard deviations, for sampling.

use std::collections::BTreeMap;

use policy::arrays::Array;
use policy::ops::LAYER_NORM_EPSILON;
use policy::standardisation::LIMIT;
use policy::{ActorPolicy, CoreKind, Head, InputNorm};

use super::onnx::{ElementType, Graph, Model, float, integer};

/// The model of one agent; `about` goes into its metadata.
pub(super) fn model(agent: &ActorPolicy, about: &BTreeMap<String, String>) -> Model {
    let mut graph = Graph::new("policy".to_owned());
    // No node uses the deviations of actions; the metadata contains them as `sigma`.
    for (name, array) in agent.arrays().iter().filter(|(name, _)| *name != "head.log_std") {
        let Array::F32 { shape, data } = array else { unreachable!("{name}: policies are f32") };
        graph.constant(name, shape, data);
    }
    graph.input("observation", agent.observation_size());
    let seen = standardised(&mut graph, agent);
    let features = match agent.spec().core() {
        CoreKind::Gru => recurrent(&mut graph, agent, seen),
        CoreKind::Mlp => feed_forward(&mut graph, agent, seen),
    };
    dense(&mut graph, "head", &features, "output");
    graph.output("output", ElementType::Float, agent.output_size());
    action(&mut graph, agent);
    let sigma = agent.sigma().iter().map(f32::to_string).collect::<Vec<_>>().join(" ");
    let mut about = about.clone();
    about.insert("sigma".to_owned(), sigma);
    Model::new(graph, &about)
}

/// `clamp((x - mean) / deviation)`, where the policy standardises.
fn standardised(graph: &mut Graph, agent: &ActorPolicy) -> &'static str {
    if !agent.arrays().contains_key("input.mean") {
        return "observation";
    }
    graph.constant("input.low", &[], &[-LIMIT]);
    graph.constant("input.high", &[], &[LIMIT]);
    graph.node("Sub", &["observation", "input.mean"], &["input.centred"], []);
    graph.node("Mul", &["input.centred", "input.inverse_deviation"], &["input.scaled"], []);
    graph.node("Clip", &["input.scaled", "input.low", "input.high"], &["input.seen"], []);
    "input.seen"
}

/// Gates r, z, n: `h' = (1 - z) n + z h` with `n = tanh(W x + r (U h))`.
fn recurrent(graph: &mut Graph, agent: &ActorPolicy, seen: &str) -> String {
    graph.input("hidden", agent.hidden_size());
    let below = input_norm(graph, agent, seen);
    dense(graph, "encoder.linear", &below, "encoder.sum");
    graph.node("Tanh", &["encoder.sum"], &["encoded"], []);
    product(graph, ["encoded", "gru.weight_ih", "gru.bias_ih"], "gru.input");
    product(graph, ["hidden", "gru.weight_hh", "gru.bias_hh"], "gru.recurrent");
    for part in ["gru.input", "gru.recurrent"] {
        let gates = ["r", "z", "n"].map(|gate| format!("{part}.{gate}"));
        let [r, z, n] = gates.each_ref().map(String::as_str);
        graph.node("Split", &[part], &[r, z, n], [integer("axis", 1)]);
    }
    for gate in ["r", "z"] {
        let (input, recurrent) = (format!("gru.input.{gate}"), format!("gru.recurrent.{gate}"));
        let sum = format!("gru.{gate}.sum");
        graph.node("Add", &[&input, &recurrent], &[&sum], []);
        graph.node("Sigmoid", &[&sum], &[&format!("gru.{gate}")], []);
    }
    graph.node("Mul", &["gru.r", "gru.recurrent.n"], &["gru.n.recurrent"], []);
    graph.node("Add", &["gru.input.n", "gru.n.recurrent"], &["gru.n.sum"], []);
    graph.node("Tanh", &["gru.n.sum"], &["gru.n"], []);
    graph.constant("one", &[], &[1.0]);
    graph.node("Sub", &["one", "gru.z"], &["gru.taken"], []);
    graph.node("Mul", &["gru.taken", "gru.n"], &["gru.new"], []);
    graph.node("Mul", &["gru.z", "hidden"], &["gru.kept"], []);
    graph.node("Add", &["gru.new", "gru.kept"], &["next_hidden"], []);
    graph.output("next_hidden", ElementType::Float, agent.hidden_size());
    norm(graph, "output.norm", "next_hidden", "features");
    "features".to_owned()
}

fn feed_forward(graph: &mut Graph, agent: &ActorPolicy, seen: &str) -> String {
    let mut below = input_norm(graph, agent, seen);
    for layer in 0..agent.spec().layers() {
        let [sum, positive, normal] =
            ["sum", "positive", "normal"].map(|part| format!("layers.{layer}.{part}"));
        dense(graph, &format!("layers.{layer}.linear"), &below, &sum);
        graph.node("Relu", &[&sum], &[&positive], []);
        norm(graph, &format!("layers.{layer}.norm"), &positive, &normal);
        below = normal;
    }
    below
}

/// Input of the first layer.
fn input_norm(graph: &mut Graph, agent: &ActorPolicy, seen: &str) -> String {
    match agent.spec().input_norm() {
        InputNorm::None => seen.to_owned(),
        InputNorm::LayerNorm => {
            norm(graph, "encoder.norm", seen, "encoder.normal");
            "encoder.normal".to_owned()
        }
    }
}

/// The action of an evaluation, from the network's output.
fn action(graph: &mut Graph, agent: &ActorPolicy) {
    match agent.head() {
        Head::Gaussian => graph.node("Identity", &["output"], &["action"], []),
        Head::Categorical { .. } => {
            let attributes = [integer("axis", 1), integer("keepdims", 1)];
            graph.node("ArgMax", &["output"], &["action"], attributes);
            return graph.output("action", ElementType::Int64, 1);
        }
        Head::Deterministic { low, high, .. } | Head::Uniform { low, high } => {
            graph.constant("action.half", &[], &[0.5 * (high - low)]);
            graph.constant("action.middle", &[], &[0.5 * (high + low)]);
            graph.node("Tanh", &["output"], &["action.tanh"], []);
            graph.node("Mul", &["action.tanh", "action.half"], &["action.scaled"], []);
            graph.node("Add", &["action.scaled", "action.middle"], &["action"], []);
        }
    }
    graph.output("action", ElementType::Float, agent.action_size());
}

fn norm(graph: &mut Graph, name: &str, from: &str, to: &str) {
    let inputs = [from, &format!("{name}.weight"), &format!("{name}.bias")];
    let epsilon = float("epsilon", LAYER_NORM_EPSILON);
    graph.node("LayerNormalization", &inputs, &[to], [integer("axis", -1), epsilon]);
}

fn dense(graph: &mut Graph, name: &str, from: &str, to: &str) {
    product(graph, [from, &format!("{name}.weight"), &format!("{name}.bias")], to);
}

/// `x W^T + b`
fn product(graph: &mut Graph, inputs: [&str; 3], to: &str) {
    graph.node("Gemm", &inputs, &[to], [integer("transB", 1)]);
}
