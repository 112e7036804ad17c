//! What a program that offers environments may answer: its specification, and views, steps and states that must have
//! the shapes of the specification.
#![no_main]
#![expect(dead_code, reason = "the samples also have messages between learner and actors")]

#[path = "../../proto/tests/wire/sample.rs"]
mod sample;

use libfuzzer_sys::fuzz_target;
use prost::Message;
use proto::{EnvironmentSpec, Steps, View, saved_state, wire};

/// Environments of a step.
const COUNT: usize = 2;

fuzz_target!(|data: &[u8]| {
    let Some((kind, bytes)) = data.split_first() else { return };
    match kind % 2 {
        0 => described(bytes),
        _ => answered(bytes),
    }
});

fn described(bytes: &[u8]) {
    let Ok(answer) = wire::DescribeEnvironmentResponse::decode(bytes) else { return };
    let Ok(spec) = EnvironmentSpec::from_service(answer) else { return };
    let again = wire::DescribeEnvironmentResponse { environment: Some(spec.to_wire()) };
    assert_eq!(EnvironmentSpec::from_service(again), Ok(spec));
}

fn answered(bytes: &[u8]) {
    let Ok(answer) = wire::PlayResponse::decode(bytes) else { return };
    let spec = sample::environment();
    if let Ok(view) = View::from_wire(&answer, &spec) {
        fits(&view, &spec, 1);
    }
    if let Ok(steps) = Steps::from_wire(&answer, &spec, COUNT) {
        fits(&steps.view, &spec, COUNT);
        assert!(steps.reward.iter().all(|reward| reward.is_finite()));
        let lengths = [steps.reward.len(), steps.terminated.len(), steps.truncated.len()];
        assert_eq!(lengths, [COUNT; 3]);
    }
    if let Ok(state) = saved_state(&answer, &spec) {
        assert!((1..=spec.max_state_bytes as usize).contains(&state.len()));
    }
}

fn fits(view: &View, spec: &EnvironmentSpec, count: usize) {
    assert_eq!(view.observations.len(), spec.agents.len());
    for (observation, agent) in view.observations.iter().zip(&spec.agents) {
        assert_eq!(observation.len(), count * agent.observation.len());
        assert!(observation.iter().all(|number| number.is_finite()));
    }
    assert_eq!(view.state.len(), count * spec.state.len());
    assert!(view.state.iter().all(|number| number.is_finite()));
}
