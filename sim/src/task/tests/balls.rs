//! Tests of tasks with ball joints: names, actions, observations, starts and hostile states.

use super::*;
use crate::state::State;

const MODEL: &str = "<mujoco><compiler angle=\"radian\"/><worldbody>\
    <body pos=\"0 0 1\"><joint name=\"yaw\"/><geom size=\"0.1\" contype=\"0\"/>\
    <body pos=\"0.2 0 0\"><joint name=\"wrist\" type=\"ball\" range=\"0 1\"/><geom size=\"0.1\" pos=\"0 0 0.2\" contype=\"0\"/>\
    </body></body></worldbody><actuator><motor joint=\"yaw\" ctrlrange=\"-1 1\"/>\
    <position name=\"nod\" joint=\"wrist\" kp=\"5\" gear=\"0 2 0\" ctrlrange=\"-1 1\"/>\
    <motor name=\"roll\" joint=\"wrist\" gear=\"1 0 1\" ctrlrange=\"-1 1\"/></actuator></mujoco>";
/// The wrist starts turned by 0.4 rad about its y axis.
const FILE: &str = "robot = \"arm\"\nmodel = \"arm.xml\"\nframe_skip = 1\nepisode_steps = 9\n\
    [agents]\np = [[\"yaw\"], [\"wrist\"]]\n[[reward]]\nterm = \"alive\"\nweight = 1.0\n\
    [actions]\naround = \"start\"\n[start]\npositions = { uniform = 0.1 }\n\
    coordinates = { \"wrist.qw\" = 0.980067, \"wrist.qy\" = 0.198669 }\n";

fn arm(mode: ObservationMode) -> Box<dyn EnvironmentBatch> {
    arm_of((FILE, MODEL), mode)
}

fn arm_of((file, model): (&str, &str), mode: ObservationMode) -> Box<dyn EnvironmentBatch> {
    let definition = TaskDefinition { file: file.to_owned(), model: model.to_owned() };
    let task = "arm-p".to_owned();
    let config = TaskConfig { task, definition: Some(definition), ..config(file, mode) };
    environments(&config, 1).unwrap()
}

#[test]
fn the_quaternion_of_a_ball_joint_in_a_keyframe_is_normalised() {
    let keyframe = "<keyframe><key name=\"k\" qpos=\"0 2 1 0 2\"/></keyframe></mujoco>";
    let model = MODEL.replace("</mujoco>", keyframe);
    let (head, _) = FILE.split_once("positions").unwrap();
    let file = format!("{head}keyframe = \"k\"\n");
    let mut arm = arm_of((&file, &model), ObservationMode::FullId);
    arm.reset(0, 0, 9, [3; 32]).unwrap();
    let wrist = &arm.state_of(0)[1..5];
    let off = wrist.iter().zip([2.0, 1.0, 0.0, 2.0]).map(|(got, want)| (got - want / 3.0).abs());
    assert!(off.fold(0.0, f32::max) < 1e-6, "{wrist:?}");
}

#[test]
fn a_start_with_one_number_of_a_quaternion_is_told_to_state_all_four() {
    let file = FILE.replace("\"wrist.qy\" = 0.198669", "\"wrist.qy\" = 1.0");
    let definition = TaskDefinition { file: file.clone(), model: MODEL.to_owned() };
    let config = TaskConfig {
        task: "arm-p".to_owned(),
        definition: Some(definition),
        ..config(&file, ObservationMode::FullId)
    };
    let error = environments(&config, 1).map(drop).unwrap_err().to_string();
    let place = "start.coordinates (length of the quaternion `wrist.qw` to `wrist.qz`)";
    assert!(error.contains(place), "{error}");
}

#[test]
fn a_ball_joint_has_a_quaternion_three_speeds_and_one_action_per_actuator() {
    let arm = arm(ObservationMode::FullId);
    let names: Vec<&str> = arm.description().state.iter().map(|own| own.name.as_str()).collect();
    let expected = "yaw.position wrist.qw.position wrist.qx.position wrist.qy.position wrist.qz.position \
        yaw.velocity wrist.wx.velocity wrist.wy.velocity wrist.wz.velocity";
    assert_eq!(names.join(" "), expected);
    assert_eq!(arm.description().agents[1].action.size, 2);
    // The servo holds gear x 0.4 rad.
    let [held, free] = arm.control_ranges(1)[..] else { panic!("two controls") };
    assert!((held[0] + 0.2).abs() < 1e-5 && (held[1] - 1.8).abs() < 1e-5, "{held:?}");
    assert_eq!(free, [-1.0, 1.0]);
}

#[test]
fn an_agent_observes_the_numbers_of_its_own_ball_joint() {
    let arm = arm(ObservationMode::KNearest);
    let seen = arm.description().agents[1].observation.iter().map(|own| own.name.as_str());
    let seen: Vec<&str> = seen.collect();
    assert_eq!(seen[0], "wrist.qw.position");
    assert_eq!(seen[4..], ["wrist.wx.velocity", "wrist.wy.velocity", "wrist.wz.velocity"]);
}

#[test]
fn a_ball_joint_starts_and_is_restored_with_a_unit_quaternion() {
    let mut arm = arm(ObservationMode::FullId);
    arm.reset(0, 0, 9, [3; 32]).unwrap();
    let bounds = arm.state_bounds().unwrap().clone();
    let mut state = State::from_bytes(&arm.encode(0).unwrap(), &bounds).unwrap();
    let squared = |state: &State| state.coordinates[1..5].iter().map(|q| q * q).sum::<f32>();
    assert!((squared(&state) - 1.0).abs() < 1e-6 && state.coordinates[2] != 0.0);
    state.coordinates[1] -= 0.1;
    let refused = arm.restore(0, &state.to_bytes(&bounds.kind)).unwrap_err().to_string();
    assert!(refused.contains("the orientation at coordinate 1 has squared length"), "{refused}");
}
