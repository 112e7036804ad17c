//! Requests to an environment service and its answers, of which an invalid one is rejected by name.

use bytes::Bytes;
use proto::Reason::{BadShape, BadValue, Inconsistent, MissingField, NotFinite};
use proto::wire::play_request::Request;
use proto::wire::play_response::Answer;
use proto::{EnvironmentSpec, PlayRequest, Reason, Refusal, Steps, View, saved_state, wire};

use crate::assert_refused;
use crate::peer::{steps_answer, view_answer};
use crate::sample::environment;

fn view(count: usize) -> View {
    let rows = |size: usize| (0..count * size).map(|i| i as f32).collect::<Vec<_>>();
    View { observations: vec![rows(3), rows(2)], state: rows(4) }
}

fn steps() -> Steps {
    Steps {
        view: view(2),
        reward: vec![0.5, -1.0],
        terminated: vec![true, false],
        truncated: vec![false, true],
    }
}

fn saved(bytes: usize) -> wire::PlayResponse {
    let state = wire::EnvironmentState { state: vec![7; bytes].into() };
    wire::PlayResponse { answer: Some(Answer::Saved(state)) }
}

#[test]
fn a_request_has_its_environments_and_the_actions_as_rows() {
    let reset = PlayRequest::Reset { environment: 3, seed: [9; 32] }.to_wire();
    let expected = wire::ResetEnvironment { environment: 3, seed: vec![9; 32].into() };
    assert_eq!(reset.request, Some(Request::Reset(expected)));
    let restore = PlayRequest::Restore { environment: 0, state: vec![1, 2] }.to_wire();
    let expected = wire::RestoreEnvironment { environment: 0, state: vec![1, 2].into() };
    assert_eq!(restore.request, Some(Request::Restore(expected)));
    let save = PlayRequest::Save { environment: 1 }.to_wire();
    assert_eq!(save.request, Some(Request::Save(wire::SaveEnvironment { environment: 1 })));
    let actions = vec![vec![0.1, 0.2, 0.3, 0.4], vec![-1.0, 1.0]];
    let step = PlayRequest::Step { environments: vec![0, 2], actions }.to_wire();
    let Some(Request::Step(step)) = step.request else { panic!("no step") };
    assert_eq!(step.environments, [0, 2]);
    let shapes = step.actions.iter().map(|rows| rows.shape.as_slice()).collect::<Vec<_>>();
    assert_eq!(shapes, [[2, 2], [2, 1]]);
    let first: Vec<u8> = [0.1_f32, 0.2, 0.3, 0.4].iter().flat_map(|x| x.to_le_bytes()).collect();
    assert_eq!(step.actions[0].data, first);
}

#[test]
fn answers_are_read() {
    let spec = environment();
    assert_eq!(View::from_wire(&view_answer(&view(1)), &spec), Ok(view(1)));
    assert_eq!(Steps::from_wire(&steps_answer(&steps()), &spec, 2), Ok(steps()));
    assert_eq!(saved_state(&saved(64), &spec), Ok(vec![7; 64]));
}

#[test]
fn an_answer_that_does_not_fit_is_refused_by_name() {
    type Lie = (fn(&mut wire::EnvironmentsSteps), Reason, &'static str);
    let lies: [Lie; 6] = [
        (|steps| steps.view = None, MissingField, "steps.view"),
        (|steps| steps.reward = None, MissingField, "steps.reward"),
        (
            |steps| steps.terminated.as_mut().unwrap().data = Bytes::from_static(&[1, 2]),
            BadValue,
            "steps.terminated",
        ),
        (|steps| steps.truncated = steps.terminated.clone(), Inconsistent, "steps.truncated"),
        (
            |steps| steps.view.as_mut().unwrap().observations.swap(0, 1),
            BadShape,
            "steps.view.observations[0]",
        ),
        (
            |steps| {
                let state = steps.view.as_mut().unwrap().state.as_mut().unwrap();
                state.data = f32::INFINITY.to_le_bytes().repeat(8).into();
            },
            NotFinite,
            "steps.view.state",
        ),
    ];
    for (lie, reason, field) in lies {
        let mut answer = steps_answer(&steps());
        let Some(Answer::Steps(steps)) = &mut answer.answer else { panic!("no steps") };
        lie(steps);
        assert_refused(Steps::from_wire(&answer, &environment(), 2), reason, field);
    }
}

#[test]
fn another_answer_than_the_one_asked_for_is_refused() {
    let nothing = wire::PlayResponse { answer: None };
    for (answer, message) in [
        (steps_answer(&steps()), "BAD_VALUE: answer: steps, expected view"),
        (nothing, "MISSING_FIELD: answer: must be set"),
    ] {
        let refusal = View::from_wire(&answer, &environment()).unwrap_err();
        assert_eq!(refusal.to_string(), message);
    }
}

#[test]
fn a_saved_state_has_bytes_and_not_more_than_it_may() {
    for bytes in [0, 65] {
        let refusal = saved_state(&saved(bytes), &environment()).unwrap_err();
        let detail = format!("BAD_VALUE: saved.state: {bytes} bytes, expected 1 to 64");
        assert_eq!(refusal.to_string(), detail);
    }
}

fn described(spec: &EnvironmentSpec) -> Result<EnvironmentSpec, Refusal> {
    let environment = Some(spec.to_wire());
    EnvironmentSpec::from_service(wire::DescribeEnvironmentResponse { environment })
}

#[test]
fn a_program_that_cannot_save_states_is_no_liar_and_equal_descriptions_have_one_digest() {
    let reward_terms = Vec::new();
    let offered = EnvironmentSpec { max_state_bytes: 0, reward_terms, ..environment() };
    assert_eq!(described(&offered).map(|spec| spec.digest()), Ok(offered.digest()));
    assert_ne!(offered.digest(), environment().digest());
    let unsaved = EnvironmentSpec { state_kind: String::new(), ..environment() };
    assert!(described(&unsaved).is_ok());
}

#[test]
fn a_name_of_an_environment_that_cannot_be_shown_is_refused_by_its_field() {
    type NameOf = fn(&mut EnvironmentSpec) -> &mut String;
    let named: [(&str, NameOf); 6] = [
        ("task", |spec| &mut spec.task),
        ("state_kind", |spec| &mut spec.state_kind),
        ("state[1].name", |spec| &mut spec.state[1].name),
        ("agents[1].name", |spec| &mut spec.agents[1].name),
        ("agents[0].joints[1]", |spec| &mut spec.agents[0].joints[1]),
        ("agents[0].observation[2].name", |spec| &mut spec.agents[0].observation[2].name),
    ];
    let unnamed = EnvironmentSpec { task: String::new(), ..environment() };
    assert_refused(described(&unnamed), BadValue, "environment.task");
    for (field, name) in named {
        for hostile in ["a ", "a\nb", "a\u{2029}b", "a\u{2066}b", "\u{feff}a"] {
            let mut spec = environment();
            hostile.clone_into(name(&mut spec));
            assert_refused(described(&spec), BadValue, &format!("environment.{field}"));
        }
    }
}

#[test]
fn a_description_with_which_no_run_can_work_is_refused_by_name() {
    type Lie = fn(&mut EnvironmentSpec);
    let lies: [(Lie, &str); 5] = [
        (|spec| spec.feature_z = true, "feature_z"),
        (|spec| spec.agents.clear(), "agents"),
        (|spec| spec.agents[1].observation.clear(), "agents[1].observation"),
        (|spec| spec.agents[0].seen = vec![4], "agents[0].seen"),
        (|spec| spec.agents[0].action.low = f32::NAN, "agents[0].action.high"),
    ];
    for (lie, field) in lies {
        let mut spec = environment();
        lie(&mut spec);
        assert_refused(described(&spec), BadValue, &format!("environment.{field}"));
    }
}
