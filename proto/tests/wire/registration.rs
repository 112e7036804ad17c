//! Which actors may register.

use proto::Reason::{BadValue, OtherBuild, OtherEnvironment, OtherFingerprint, OtherProtocol};
use proto::{
    Digest, EnvironmentSpec, FeatureRole, PROTOCOL_VERSION, ProcessId, Registration,
    RunDescription, wire,
};

use crate::{assert_refused, sample, sent};

fn registration() -> Registration {
    Registration {
        client: "test".to_owned(),
        build: sample::run().build,
        protocol_version: PROTOCOL_VERSION,
        environment: sample::environment(),
        rollout_fingerprint: Some(sample::run().rollout_fingerprint),
        process: Some(ProcessId([7; 16])),
    }
}

#[test]
fn an_actor_with_the_same_environment_is_read_and_admitted_with_and_without_ids() {
    let exact = registration().rollout_fingerprint;
    for (rollout_fingerprint, process) in
        [(exact, Some(ProcessId([0; 16]))), (exact, None), (None, Some(ProcessId([9; 16])))]
    {
        let actor = Registration { rollout_fingerprint, process, ..registration() };
        assert_eq!(Registration::from_wire(sent(&actor.to_wire())), Ok(actor.clone()));
        assert_eq!(actor.check(&sample::run()), Ok(()));
    }
}

#[test]
fn a_name_that_could_fill_the_memory_or_forge_a_line_of_a_log_is_refused() {
    let named = |client: &str| {
        let named = Registration { client: client.to_owned(), ..registration() };
        Registration::from_wire(named.to_wire())
    };
    assert!(named(&"n".repeat(128)).is_ok());
    // `proto/src/name.rs` tests every kind of name.
    for hostile in ["n".repeat(129).as_str(), "a\n2026-01-01 INFO all is well", ""] {
        assert_refused(named(hostile), BadValue, "client");
    }
}

#[test]
fn an_id_of_a_process_with_another_length_is_refused_by_name() {
    for length in [0, 15, 17] {
        let process = Some(vec![7; length].into());
        let wire = wire::RegisterRequest { process, ..registration().to_wire() };
        let refusal = Registration::from_wire(wire).unwrap_err();
        assert_eq!(refusal.detail, format!("{length} bytes, an id of a process has 16"));
        assert_refused(Err::<(), _>(refusal), BadValue, "process");
    }
}

#[test]
fn another_fingerprint_or_protocol_is_refused() {
    let other = Registration { rollout_fingerprint: Some(Digest([8; 32])), ..registration() };
    assert_refused(other.check(&sample::run()), OtherFingerprint, "rollout_fingerprint");
    let other = Registration { protocol_version: PROTOCOL_VERSION + 1, ..registration() };
    assert_refused(other.check(&sample::run()), OtherProtocol, "protocol_version");
}

#[test]
fn another_build_is_refused_by_name_unless_the_run_allows_it_and_the_fingerprint_fits() {
    let other = Registration { build: "0.2.0+def".to_owned(), ..registration() };
    let refusal = other.check(&sample::run()).unwrap_err();
    let named = "the actor test is of build \"0.2.0+def\", the learner of \"0.1.0+abc\"";
    assert!(refusal.detail.starts_with(named), "{refusal}");
    assert_refused(Err::<(), _>(refusal), OtherBuild, "build");
    let lenient = RunDescription { other_builds: true, ..sample::run() };
    assert_eq!(other.check(&lenient), Ok(()));
    let differs = Registration { rollout_fingerprint: Some(Digest([8; 32])), ..other.clone() };
    assert_refused(differs.check(&lenient), OtherFingerprint, "rollout_fingerprint");
    let foreign = Registration { rollout_fingerprint: None, ..other };
    assert_eq!(foreign.check(&sample::run()), Ok(()));
}

#[test]
fn indices_near_an_agent_and_terms_of_the_reward_are_neither_compared_nor_checked() {
    let mut other = registration();
    other.environment.reward_terms = vec![" ".to_owned()];
    other.environment.agents[0].near = vec![9999];
    assert_eq!(other.check(&sample::run()), Ok(()));
    let environment = Some(other.environment.to_wire());
    other.environment.reward_terms.clear();
    let answer = wire::DescribeEnvironmentResponse { environment };
    assert_eq!(EnvironmentSpec::from_service(answer), Ok(other.environment));
}

#[test]
fn another_environment_is_refused_with_its_first_difference() {
    type Change = fn(&mut EnvironmentSpec);
    let cases: [(Change, &str, &str); 10] = [
        (|e| e.task = "ant".into(), "task", r#"is "ant", expected "rapier/halfcheetah-2x3""#),
        (|e| e.agents.truncate(1), "agents.len", "is 1, expected 2"),
        (|e| e.agents[1].action.high = 2.0, "agents[1].action.high", "is 2.0, expected 1.0"),
        (
            |e| e.agents[0].action.choices = Some(4),
            "agents[0].action.choices",
            "is Some(4), expected None",
        ),
        (
            |e| e.agents[0].joints.swap(0, 1),
            "agents[0].joints[0]",
            r#"is "agent_0.knee", expected "agent_0.hip""#,
        ),
        (|e| e.agents[1].observation.truncate(1), "agents[1].observation.len", "is 1, expected 2"),
        (
            |e| e.state[1].role = FeatureRole::Signal,
            "state[1].role",
            "is Signal, expected Identity",
        ),
        (|e| e.dt_secs = f64::NAN, "dt_secs", "is NaN, expected 0.05"),
        (|e| e.max_state_bytes = 0, "max_state_bytes", "is 0, expected 64"),
        (|e| e.feature_z = true, "feature_z", "is true, expected false"),
    ];
    for (change, path, difference) in cases {
        let mut registration = registration();
        change(&mut registration.environment);
        let refusal = registration.check(&sample::run()).unwrap_err();
        assert_eq!(refusal.detail, format!("{path} {difference}"));
        assert_refused(Err::<(), _>(refusal), OtherEnvironment, &format!("environment.{path}"));
    }
}
