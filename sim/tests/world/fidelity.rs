//! All robots compared with MuJoCo's recorded motion. The `fidelity` example prints the whole table.

#[path = "../../examples/fidelity/compare.rs"]
mod compare;

use compare::{ROBOTS, Traces};

#[test]
fn in_free_flight_with_short_steps_every_robot_moves_as_in_mujoco() {
    let traces = Traces::read();
    println!("against {}", traces.source());
    for robot in ROBOTS {
        let last = *traces.flight(robot, 32).last().unwrap();
        println!("{}: {last:?}", robot.0);
        assert!(last.angle < 1e-3 && last.largest < 3e-3, "{}: {last:?}", robot.0);
    }
}

#[test]
fn on_the_ground_differences_from_mujoco_stay_within_the_documented_table() {
    let traces = Traces::read();
    // Bounds of x (m) and hinge angles (rad) after half a second under full torque, with a small margin.
    for (robot, [place, angle]) in
        ROBOTS.into_iter().zip([[0.05, 0.04], [0.17, 0.45], [0.16, 0.04]])
    {
        let [ours, own] = traces.ground(robot, "full");
        println!("{}: {:?}, MuJoCo itself {:?}", robot.0, ours[1], own[1]);
        assert!(ours[1].place < place && ours[1].angle < angle, "{}: {:?}", robot.0, ours[1]);
    }
}
