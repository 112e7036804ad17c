//! A policy's network as an ONNX model: `observation` and `hidden` in, `action` and `next_hidden` out.
//!
//! `action` is the action of an evaluation: the mean, or the index of the likeliest choice. `output` is the output of
//! the network: means before squashing, or logits. The metadata contains the standard deviations, for sampling.
//! Field numbers are those of `onnx.proto` 1.16, IR version 8.

use std::collections::BTreeMap;

use policy::arrays::Array;
use policy::ops::LAYER_NORM_EPSILON;
use policy::standardisation::LIMIT;
use policy::{ActorPolicy, CoreKind, Head, InputNorm};
use prost::Message;

/// IR version 8 came with operator set 17, the first that has `LayerNormalization`.
const IR_VERSION: i64 = 8;

const OPERATOR_SET: i64 = 17;

/// `ModelProto`
#[derive(Clone, PartialEq, Message)]
pub(super) struct Model {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(string, tag = "2")]
    producer_name: String,
    #[prost(string, tag = "3")]
    producer_version: String,
    #[prost(message, optional, tag = "7")]
    graph: Option<Graph>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<OperatorSet>,
    #[prost(message, repeated, tag = "14")]
    metadata_props: Vec<Entry>,
}

impl Model {
    fn new(graph: Graph, about: &BTreeMap<String, String>) -> Self {
        let entry =
            |(key, value): (&String, &String)| Entry { key: key.clone(), value: value.clone() };
        Self {
            ir_version: IR_VERSION,
            producer_name: "s2mia".to_owned(),
            producer_version: env!("CARGO_PKG_VERSION").to_owned(),
            graph: Some(graph),
            opset_import: vec![OperatorSet { domain: String::new(), version: OPERATOR_SET }],
            metadata_props: about.iter().map(entry).collect(),
        }
    }

    pub(super) fn to_bytes(&self) -> Vec<u8> {
        self.encode_to_vec()
    }
}

/// The model of one agent; `about` goes into its metadata.
pub(super) fn model(agent: &ActorPolicy, about: &BTreeMap<String, String>) -> Model {
    let mut graph = Graph::new("policy".to_owned());
    // No node uses the deviations of actions, which the metadata contain as `sigma`, or their correlation.
    let unused = ["head.log_std", "head.loading"];
    for (name, array) in agent.arrays().iter().filter(|(name, _)| !unused.contains(&name.as_str()))
    {
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

/// `TensorProto.DataType`
#[derive(Clone, Copy)]
enum ElementType {
    Float = 1,
    Int64 = 7,
}

/// `OperatorSetIdProto`
#[derive(Clone, PartialEq, Message)]
struct OperatorSet {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

/// `StringStringEntryProto`
#[derive(Clone, PartialEq, Message)]
struct Entry {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

/// `GraphProto`
#[derive(Clone, PartialEq, Message)]
struct Graph {
    #[prost(message, repeated, tag = "1")]
    node: Vec<Node>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    initializer: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    input: Vec<Value>,
    #[prost(message, repeated, tag = "12")]
    output: Vec<Value>,
}

/// `NodeProto`
#[derive(Clone, PartialEq, Message)]
struct Node {
    #[prost(string, repeated, tag = "1")]
    input: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    output: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    op_type: String,
    #[prost(message, repeated, tag = "5")]
    attribute: Vec<Attribute>,
}

/// `AttributeProto`, of the kinds used here.
#[derive(Clone, PartialEq, Message)]
struct Attribute {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(float, optional, tag = "2")]
    f: Option<f32>,
    #[prost(int64, optional, tag = "3")]
    i: Option<i64>,
    /// 1 float, 2 integer.
    #[prost(int32, tag = "20")]
    kind: i32,
}

/// `TensorProto`
#[derive(Clone, PartialEq, Message)]
struct Tensor {
    #[prost(int64, repeated, tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(string, tag = "8")]
    name: String,
    #[prost(bytes = "vec", tag = "9")]
    raw_data: Vec<u8>,
}

/// `ValueInfoProto`
#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    r#type: Option<Type>,
}

/// `TypeProto`, always a tensor.
#[derive(Clone, PartialEq, Message)]
struct Type {
    #[prost(message, optional, tag = "1")]
    tensor_type: Option<TensorType>,
}

/// `TypeProto.Tensor`
#[derive(Clone, PartialEq, Message)]
struct TensorType {
    #[prost(int32, tag = "1")]
    elem_type: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<Shape>,
}

/// `TensorShapeProto`
#[derive(Clone, PartialEq, Message)]
struct Shape {
    #[prost(message, repeated, tag = "1")]
    dim: Vec<Dimension>,
}

/// `TensorShapeProto.Dimension`: a length or the name of one.
#[derive(Clone, PartialEq, Message)]
struct Dimension {
    #[prost(int64, optional, tag = "1")]
    dim_value: Option<i64>,
    #[prost(string, optional, tag = "2")]
    dim_param: Option<String>,
}

impl Graph {
    fn new(name: String) -> Self {
        Self { name, ..Self::default() }
    }

    /// An input `[rows, width]`, any number of rows.
    fn input(&mut self, name: &str, width: usize) {
        self.input.push(rows_of(name, ElementType::Float, width));
    }

    /// An output `[rows, width]`.
    fn output(&mut self, name: &str, element: ElementType, width: usize) {
        self.output.push(rows_of(name, element, width));
    }

    /// A constant.
    fn constant(&mut self, name: &str, shape: &[usize], data: &[f32]) {
        self.initializer.push(Tensor {
            dims: shape.iter().map(|&length| length as i64).collect(),
            data_type: ElementType::Float as i32,
            name: name.to_owned(),
            raw_data: data.iter().flat_map(|x| x.to_le_bytes()).collect(),
        });
    }

    /// `outputs = operator(inputs)`
    fn node<const ATTRIBUTES: usize>(
        &mut self,
        operator: &str,
        inputs: &[&str],
        outputs: &[&str],
        attributes: [Attribute; ATTRIBUTES],
    ) {
        let owned = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
        self.node.push(Node {
            input: owned(inputs),
            output: owned(outputs),
            name: format!("{}/{operator}", outputs[0]),
            op_type: operator.to_owned(),
            attribute: attributes.into(),
        });
    }
}

/// An attribute that is an integer.
fn integer(name: &str, value: i64) -> Attribute {
    Attribute { name: name.to_owned(), f: None, i: Some(value), kind: 2 }
}

/// An attribute that is a float.
fn float(name: &str, value: f32) -> Attribute {
    Attribute { name: name.to_owned(), f: Some(value), i: None, kind: 1 }
}

fn rows_of(name: &str, element: ElementType, width: usize) -> Value {
    let rows = Dimension { dim_value: None, dim_param: Some("rows".to_owned()) };
    let width = Dimension { dim_value: Some(width as i64), dim_param: None };
    let shape = Some(Shape { dim: vec![rows, width] });
    let tensor_type = Some(TensorType { elem_type: element as i32, shape });
    Value { name: name.to_owned(), r#type: Some(Type { tensor_type }) }
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
        below = match agent.spec().hidden_norm() {
            InputNorm::None => positive,
            InputNorm::LayerNorm => {
                norm(graph, &format!("layers.{layer}.norm"), &positive, &normal);
                normal
            }
        };
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
        Head::Gaussian | Head::SharedGaussian(_) => {
            graph.node("Identity", &["output"], &["action"], [])
        }
        Head::Categorical { .. } => {
            let attributes = [integer("axis", 1), integer("keepdims", 1)];
            graph.node("ArgMax", &["output"], &["action"], attributes);
            return graph.output("action", ElementType::Int64, 1);
        }
        Head::Deterministic { low, high, .. }
        | Head::Uniform { low, high }
        | Head::TanhGaussian { low, high, .. } => {
            let mean = match agent.head() {
                Head::TanhGaussian { .. } => {
                    let halves = ["action.mean", "action.l"];
                    graph.node("Split", &["output"], &halves, [integer("axis", 1)]);
                    halves[0]
                }
                _ => "output",
            };
            graph.constant("action.half", &[], &[0.5 * (high - low)]);
            graph.constant("action.middle", &[], &[0.5 * (high + low)]);
            graph.node("Tanh", &[mean], &["action.tanh"], []);
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
