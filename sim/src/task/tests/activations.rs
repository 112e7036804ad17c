//! Tests of tasks whose actuators have activations, which are part of their states.

use super::*;
use crate::state::State;

const MODEL: &str = "<mujoco><worldbody><body><joint name=\"j\"/><geom size=\"0.1\"/></body></worldbody><actuator>\
    <position name=\"servo\" joint=\"j\" kp=\"5\" timeconst=\"0.1\" ctrlrange=\"0 1\"/>\
    <motor name=\"plain\" joint=\"j\" ctrlrange=\"-1 1\"/>\
    <general name=\"sum\" joint=\"j\" dyntype=\"integrator\" actrange=\"0 0.3\" ctrlrange=\"-1 1\"/></actuator>\
    <keyframe><key name=\"warm\" act=\"0.5 0.2\"/><key name=\"wrong\" act=\"0.5 0.4\"/></keyframe></mujoco>";

fn wheel(start: &str) -> Result<Box<dyn EnvironmentBatch>, SimError> {
    let file = format!(
        "robot = \"wheel\"\nmodel = \"wheel.xml\"\nframe_skip = 2\nepisode_steps = 99\n[agents]\np = [[\"j\"]]\n\
         [[reward]]\nterm = \"alive\"\nweight = 1.0\n{start}"
    );
    let config = config(&file, ObservationMode::FullId);
    let definition = TaskDefinition { file, model: MODEL.to_owned() };
    environments(
        &TaskConfig { task: "wheel-p".to_owned(), definition: Some(definition), ..config },
        1,
    )
}

fn step(world: &mut dyn EnvironmentBatch) -> Vec<u8> {
    let mut outcome = [Outcome::default()];
    world.step(&[0.6, 0.1, 1.0], &mut outcome).unwrap();
    assert!(!outcome[0].fault);
    world.encode(0).unwrap()
}

#[test]
fn a_restored_world_continues_with_its_activations() {
    let [mut first, mut second] = [wheel("").unwrap(), wheel("").unwrap()];
    first.reset(0, 0, 99, [1; 32]).unwrap();
    let reached = (0..20).map(|_| step(&mut *first)).last().unwrap();
    let bounds = first.state_bounds().unwrap().clone();
    let state = State::from_bytes(&reached, &bounds).unwrap();
    // After 40 steps of 2 ms, the filter has 0.8 (1 - exp(-0.8)), and the integrator 0.08.
    for (found, expected) in state.activations.iter().zip([0.440_536_83, 0.08]) {
        assert!((found - expected).abs() < 1e-6, "{:?}", state.activations);
    }
    second.restore(0, &reached).unwrap();
    assert_eq!(second.encode(0).unwrap(), reached);
    for _ in 0..20 {
        assert_eq!(step(&mut *first), step(&mut *second));
    }
}

#[test]
fn activations_beyond_their_ranges_are_refused() {
    let mut world = wheel("").unwrap();
    let bounds = world.state_bounds().unwrap().clone();
    let state = State::from_bytes(&world.encode(0).unwrap(), &bounds).unwrap();
    for (activation, expected) in [
        (0.31, "activation 1 is 0.31; it must be between 0 and 0.3"),
        (f32::NAN, "activation 1 is not finite"),
    ] {
        let hostile = State { activations: vec![0.0, activation], ..state.clone() };
        let error = world.restore(0, &hostile.to_bytes(&bounds.kind)).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn an_episode_starts_with_the_activations_of_its_keyframe() {
    let mut world = wheel("[start]\nkeyframe = \"warm\"\n").unwrap();
    world.reset(0, 0, 99, [1; 32]).unwrap();
    let bounds = world.state_bounds().unwrap();
    let state = State::from_bytes(&world.encode(0).unwrap(), bounds).unwrap();
    assert_eq!(state.activations, [0.5, 0.2]);
    let error = wheel("[start]\nkeyframe = \"wrong\"\n").map(drop).unwrap_err().to_string();
    assert!(error.contains("start.keyframe (an activation)"), "{error}");
}

#[test]
fn a_filter_that_starts_elsewhere_than_action_0_is_named() {
    let named = |lines: &str| {
        let warnings = wheel(lines).unwrap().warnings();
        warnings.into_iter().find(|warning| warning.contains("filters start at another activation"))
    };
    let around = "[actions]\naround = \"start\"\n[start]\n";
    let at = |position: f32| format!("coordinates = {{ j = {position} }}");
    // The middle of the control range too.
    for position in [0.2, 0.5] {
        let cold = named(&format!("{around}{}", at(position))).unwrap();
        assert!(cold.contains("`servo` at 0 instead of 0."), "{cold}");
    }
    let warm = |position: f32| format!("keyframe = \"warm\"\n{}", at(position));
    let warmer = named(&format!("{around}{}", warm(0.25))).unwrap();
    assert!(warmer.contains("`servo` at 0.5 instead of 0.25"), "{warmer}");
    assert_eq!(named(&format!("{around}{}", warm(0.505))), None);
    assert_eq!(named(&format!("[start]\n{}", at(0.2))), None);
}
