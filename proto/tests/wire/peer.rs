//! Messages that only peers write: the answers of a program that offers environments, and the requests of a client of
//! trained policies.

use proto::wire::play_response::Answer;
use proto::{ActStep, ActionChoice, Steps, View, wire};

fn floats(shape: &[usize], values: &[f32]) -> wire::Tensor {
    let data = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    tensor(wire::DataType::F32, shape, data)
}

fn flags(values: &[bool]) -> wire::Tensor {
    let data = values.iter().copied().map(u8::from).collect();
    tensor(wire::DataType::Bool, &[values.len()], data)
}

fn tensor(data_type: wire::DataType, shape: &[usize], data: Vec<u8>) -> wire::Tensor {
    let shape = shape.iter().map(|size| *size as u32).collect();
    wire::Tensor { data_type: data_type.into(), shape, data: data.into() }
}

fn view(view: &View, count: usize) -> wire::EnvironmentsView {
    let rows = |values: &Vec<f32>| floats(&[count, values.len() / count], values);
    wire::EnvironmentsView {
        observations: view.observations.iter().map(rows).collect(),
        state: Some(rows(&view.state)),
    }
}

/// The answer to a reset or a restore of an environment.
pub(crate) fn view_answer(seen: &View) -> wire::PlayResponse {
    wire::PlayResponse { answer: Some(Answer::View(view(seen, 1))) }
}

/// The answer to a step.
pub(crate) fn steps_answer(steps: &Steps) -> wire::PlayResponse {
    let count = steps.reward.len();
    let steps = wire::EnvironmentsSteps {
        view: Some(view(&steps.view, count)),
        reward: Some(floats(&[count], &steps.reward)),
        terminated: Some(flags(&steps.terminated)),
        truncated: Some(flags(&steps.truncated)),
    };
    wire::PlayResponse { answer: Some(Answer::Steps(steps)) }
}

/// The first message of a stream of steps.
pub(crate) fn start_request(choice: ActionChoice) -> wire::ActRequest {
    let choice = match choice {
        ActionChoice::Mean => wire::act_start::Choice::Mean(wire::MeanAction {}),
        ActionChoice::Sampled { seed } => {
            wire::act_start::Choice::Sampled(wire::SampledAction { seed })
        }
    };
    let start = wire::ActStart { choice: Some(choice) };
    wire::ActRequest { content: Some(wire::act_request::Content::Start(start)) }
}

/// A later message of a stream of steps.
pub(crate) fn step_request(step: &ActStep) -> wire::ActRequest {
    let observation = |(agent, observation): &(usize, Vec<f32>)| wire::AgentObservation {
        agent: *agent as u32,
        observation: Some(floats(&[observation.len()], observation)),
    };
    let observations = step.observations.iter().map(observation).collect();
    let step = wire::ActStep { reset: step.reset, observations };
    wire::ActRequest { content: Some(wire::act_request::Content::Step(step)) }
}
