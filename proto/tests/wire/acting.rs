//! Requests to trained policies are read, and an invalid step is rejected by name.

use proto::Reason::{BadShape, BadValue, MissingField, NotFinite};
use proto::{ActStep, Acted, ActionChoice, Digest, PolicyVersion, WeightsName, wire};

use crate::assert_refused;
use crate::peer::{start_request, step_request};

/// Observation sizes of the sample run's agents.
const OBSERVATIONS: [usize; 2] = [3, 2];

fn weights() -> WeightsName {
    WeightsName { version: PolicyVersion(7), digest: Digest([3; 32]) }
}

fn step() -> ActStep {
    ActStep { reset: true, observations: vec![(1, vec![0.5, -1.0]), (0, vec![1.0, 2.0, 3.0])] }
}

#[test]
fn beginnings_and_steps_are_read_and_answers_have_the_actions_of_their_agents() {
    for choice in [ActionChoice::Mean, ActionChoice::Sampled { seed: 9 }] {
        assert_eq!(ActionChoice::from_wire(start_request(choice)), Ok(choice));
    }
    assert_eq!(ActStep::from_wire(&step_request(&step()), &OBSERVATIONS), Ok(step()));
    let acted = Acted { weights: weights(), actions: vec![(1, vec![0.25]), (0, vec![1.0, -1.0])] };
    let answer = acted.to_wire();
    assert_eq!(WeightsName::from_wire(answer.weights, "weights"), Ok(weights()));
    let actions = answer.actions.iter().map(|row| {
        let action = row.action.as_ref().unwrap();
        let values = action.data.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        assert_eq!(action.shape, [values.len() as u32]);
        (row.agent as usize, values.collect::<Vec<f32>>())
    });
    assert_eq!(actions.collect::<Vec<_>>(), acted.actions);
}

#[test]
fn a_step_that_does_not_fit_the_team_is_refused_by_field() {
    for (observations, reason, field) in [
        (vec![], MissingField, ""),
        (vec![(2, vec![0.0; 2])], BadValue, "[0].agent"),
        (vec![(1, vec![0.0; 2]), (1, vec![0.0; 2])], BadValue, "[1].agent"),
        (vec![(0, vec![0.0; 2])], BadShape, "[0].observation"),
        (vec![(1, vec![0.0; 2]), (0, vec![0.0; 4])], BadShape, "[1].observation"),
        (vec![(1, vec![0.0, f32::NAN])], NotFinite, "[0].observation"),
        (vec![(1, vec![f32::INFINITY, 0.0])], NotFinite, "[0].observation"),
    ] {
        let step = step_request(&ActStep { reset: false, observations });
        let read = ActStep::from_wire(&step, &OBSERVATIONS);
        assert_refused(read, reason, &format!("step.observations{field}"));
    }
}

#[test]
fn a_stream_begins_once_and_with_its_beginning() {
    assert_refused(ActionChoice::from_wire(step_request(&step())), MissingField, "start");
    let start = start_request(ActionChoice::Mean);
    assert_refused(ActStep::from_wire(&start, &OBSERVATIONS), BadValue, "start");
    let undecided = wire::act_request::Content::Start(wire::ActStart { choice: None });
    let undecided = wire::ActRequest { content: Some(undecided) };
    assert_refused(ActionChoice::from_wire(undecided), MissingField, "start.choice");
    let nothing = wire::ActRequest { content: None };
    assert_refused(ActStep::from_wire(&nothing, &OBSERVATIONS), MissingField, "content");
}
