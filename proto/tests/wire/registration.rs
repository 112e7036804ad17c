//! Which actors may register.

use proto::{
    Digest, EnvironmentSpec, FeatureRole, PROTOCOL_VERSION, ProcessId, Reason, Refusal,
    Registration, RunDescription, wire,
};

use crate::sample;

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

fn with_environment(change: fn(&mut EnvironmentSpec)) -> Refusal {
    let mut registration = registration();
    change(&mut registration.environment);
    registration.check(&sample::run()).unwrap_err()
}

#[test]
fn an_actor_with_the_same_environment_and_fingerprint_is_admitted() {
    assert_eq!(registration().check(&sample::run()), Ok(()));
}

#[test]
fn a_client_without_a_fingerprint_is_admitted() {
    let foreign = Registration { rollout_fingerprint: None, ..registration() };
    assert_eq!(foreign.check(&sample::run()), Ok(()));
}

#[test]
fn a_name_that_could_fill_the_memory_or_forge_a_line_of_a_log_is_refused() {
    let refused = |client: &str| {
        let named = Registration { client: client.to_owned(), ..registration() };
        Registration::from_wire(named.to_wire()).err().map(|refusal| refusal.field)
    };
    assert_eq!(refused(&"n".repeat(128)), None);
    for hostile in [
        "n".repeat(129).as_str(),
        "a\n2026-01-01 INFO all is well",
        "\u{1b}[2J",
        "a\u{2028}b",
        "a\u{202e}b",
        "\u{200b}",
        " a",
        "",
    ] {
        assert_eq!(refused(hostile).as_deref(), Some("client"));
    }
}

#[test]
fn an_actor_of_a_named_process_or_of_none_is_read_and_admitted() {
    for process in [None, Some(ProcessId([0; 16])), Some(ProcessId([9; 16]))] {
        let named = Registration { process, ..registration() };
        assert_eq!(Registration::from_wire(named.to_wire()), Ok(named.clone()));
        assert_eq!(named.check(&sample::run()), Ok(()));
    }
}

#[test]
fn an_id_of_a_process_with_another_length_is_refused_by_name() {
    for length in [0, 15, 17] {
        let process = Some(vec![7; length].into());
        let wire = wire::RegisterRequest { process, ..registration().to_wire() };
        let refusal = Registration::from_wire(wire).unwrap_err();
        assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::BadValue, "process"));
        assert_eq!(refusal.detail, format!("{length} bytes, an id of a process has 16"));
    }
}

#[test]
fn another_fingerprint_or_protocol_is_refused() {
    let other = Registration { rollout_fingerprint: Some(Digest([8; 32])), ..registration() };
    assert_eq!(other.check(&sample::run()).unwrap_err().reason, Reason::OtherFingerprint);
    let other = Registration { protocol_version: PROTOCOL_VERSION + 1, ..registration() };
    assert_eq!(other.check(&sample::run()).unwrap_err().reason, Reason::OtherProtocol);
}

#[test]
fn another_build_is_refused_by_name_unless_the_run_allows_it_and_the_fingerprint_fits() {
    let other = Registration { build: "0.2.0+def".to_owned(), ..registration() };
    let refusal = other.check(&sample::run()).unwrap_err();
    assert_eq!((refusal.reason, refusal.field.as_str()), (Reason::OtherBuild, "build"));
    let named = "the actor test is of build \"0.2.0+def\", the learner of \"0.1.0+abc\"";
    assert!(refusal.detail.starts_with(named), "{refusal}");
    let lenient = RunDescription { other_builds: true, ..sample::run() };
    assert_eq!(other.check(&lenient), Ok(()));
    let differs = Registration { rollout_fingerprint: Some(Digest([8; 32])), ..other.clone() };
    assert_eq!(differs.check(&lenient).unwrap_err().reason, Reason::OtherFingerprint);
    let foreign = Registration { rollout_fingerprint: None, ..other };
    assert_eq!(foreign.check(&sample::run()), Ok(()));
}

#[test]
fn indices_near_an_agent_are_neither_compared_nor_checked() {
    let mut other = registration();
    other.environment.agents[0].near = vec![9999];
    assert_eq!(other.check(&sample::run()), Ok(()));
    let environment = Some(other.environment.to_wire());
    let answer = wire::DescribeEnvironmentResponse { environment };
    assert_eq!(EnvironmentSpec::from_service(answer), Ok(other.environment));
}

/// Spoils one field.
type Change = fn(&mut EnvironmentSpec);

#[test]
fn another_environment_is_refused_with_its_first_difference() {
    let cases: [(Change, &str, &str); 9] = [
        (
            |e| e.task = "ant".into(),
            "environment.task",
            r#"task is "ant", expected "rapier/halfcheetah-2x3""#,
        ),
        (|e| e.agents.truncate(1), "environment.agents.len", "agents.len is 1, expected 2"),
        (
            |e| e.agents[1].action.high = 2.0,
            "environment.agents[1].action.high",
            "agents[1].action.high is 2.0, expected 1.0",
        ),
        (
            |e| e.agents[0].joints.swap(0, 1),
            "environment.agents[0].joints[0]",
            r#"agents[0].joints[0] is "agent_0.knee", expected "agent_0.hip""#,
        ),
        (
            |e| e.agents[1].observation.truncate(1),
            "environment.agents[1].observation.len",
            "agents[1].observation.len is 1, expected 2",
        ),
        (
            |e| e.state[1].role = FeatureRole::Signal,
            "environment.state[1].role",
            "state[1].role is Signal, expected Identity",
        ),
        (|e| e.dt_secs = f64::NAN, "environment.dt_secs", "dt_secs is NaN, expected 0.05"),
        (
            |e| e.max_state_bytes = 0,
            "environment.max_state_bytes",
            "max_state_bytes is 0, expected 64",
        ),
        (|e| e.feature_z = true, "environment.feature_z", "feature_z is true, expected false"),
    ];
    for (change, field, detail) in cases {
        let refusal = with_environment(change);
        let found = (refusal.reason, refusal.field.as_str(), refusal.detail.as_str());
        assert_eq!(found, (Reason::OtherEnvironment, field, detail));
    }
}
