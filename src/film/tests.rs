//! What is drawn where, of robots made up for it.

use sim::{JointPose, LinkPose, LinkShape, Pose, Shape};
use tiny_skia::{Pixmap, PremultipliedColorU8};

use super::*;
use crate::config::run_config::RunConfig;
use crate::figures::style::Rgb;

const UPRIGHT: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// A ball as root and two legs, each driven by another agent.
fn two_legs() -> (RobotShapes, Pose) {
    let capsule = Shape::Capsule { half_length: 0.3, radius: 0.1 };
    let shape = |link: &str, shape| LinkShape {
        link: link.to_owned(),
        shape,
        position: [0.0; 3],
        quaternion: UPRIGHT,
    };
    let shapes = vec![
        shape("root", Shape::Sphere { radius: 0.2 }),
        shape("left", capsule.clone()),
        shape("right", capsule),
    ];
    let link = |name: &str, x: f32, z: f32| LinkPose {
        name: name.to_owned(),
        position: [x, 0.0, z],
        quaternion: UPRIGHT,
    };
    let joint = |name: &str, link: usize| JointPose {
        name: name.to_owned(),
        link,
        position: 0.0,
        velocity: 0.0,
    };
    let pose = Pose {
        links: vec![link("root", 7.0, 1.0), link("left", 6.5, 0.5), link("right", 7.5, 0.5)],
        root: 0,
        joints: vec![joint("hip_left", 1), joint("hip_right", 2)],
    };
    (RobotShapes { shapes, drivers: vec![None, Some(0), Some(1)], agents: 2 }, pose)
}

fn seen(picture: &Pixmap, camera: &Camera, point: [f32; 2]) -> Rgb {
    let (x, y) = camera.pixel(point);
    let pixel = picture.pixel(x as u32, y as u32).unwrap().demultiply();
    [pixel.red(), pixel.green(), pixel.blue()]
}

#[test]
fn a_link_is_drawn_where_it_is_in_the_colour_of_its_agent_and_nothing_far_from_it() {
    let (robot, pose) = two_legs();
    let camera = Camera { middle: 7.0, pixels_per_metre: 150.0 };
    let picture = drawing::panel(&drawing::capsules(&robot, &pose, ViewDirection::Side), &camera);
    let empty = drawing::panel(&[], &camera);
    // The ends of the left leg's middle line, then a point within its round upper end.
    for point in [[6.5, 0.2], [6.5, 0.8], [6.5, 0.88]] {
        assert_eq!(seen(&picture, &camera, point), drawing::colour(Some(0)), "{point:?}");
    }
    assert_eq!(seen(&picture, &camera, [7.0, 1.0]), drawing::colour(None));
    assert_eq!(seen(&picture, &camera, [7.5, 0.5]), drawing::colour(Some(1)));
    let colours = [drawing::colour(Some(0)), drawing::colour(Some(1)), drawing::colour(None)];
    assert!(colours[0] != colours[1] && colours[1] != colours[2] && colours[0] != colours[2]);
    for point in [[6.5, 0.95], [6.35, 0.5], [7.0, 0.5], [8.2, 1.4], [7.0, -0.1]] {
        assert_eq!(seen(&picture, &camera, point), seen(&empty, &camera, point), "{point:?}");
    }
}

#[test]
fn what_is_nearer_to_the_viewer_is_painted_later() {
    let (robot, mut pose) = two_legs();
    pose.links[1].position = [7.0, -1.0, 1.0];
    let order: Vec<_> = drawing::capsules(&robot, &pose, ViewDirection::Side)
        .iter()
        .map(|capsule| capsule.agent)
        .collect();
    assert_eq!(order, [None, Some(1), Some(0)]);
}

#[test]
fn a_capsule_that_points_at_the_viewer_is_a_disc() {
    let (mut robot, pose) = two_legs();
    let half = core::f32::consts::FRAC_1_SQRT_2;
    robot.shapes[1].quaternion = [half, 0.0, 0.0, half];
    let camera = Camera { middle: 7.0, pixels_per_metre: 150.0 };
    let picture = drawing::panel(&drawing::capsules(&robot, &pose, ViewDirection::Side), &camera);
    let empty = drawing::panel(&[], &camera);
    assert_eq!(seen(&picture, &camera, [6.5, 0.5]), drawing::colour(Some(0)));
    assert_eq!(seen(&picture, &camera, [6.5, 0.8]), seen(&empty, &camera, [6.5, 0.8]));
}

#[test]
fn a_strip_is_as_large_as_it_says_and_shows_every_agent() {
    let (robot, pose) = two_legs();
    let frames: Vec<_> =
        (0..5).map(|k| TimedPose { time_secs: f64::from(k), pose: &pose }).collect();
    let picture = Pixmap::decode_png(&strip(&robot, &frames).unwrap()).unwrap();
    assert_eq!((picture.width(), picture.height()), size(5, 2));
    for agent in [Some(0), Some(1), None] {
        let [red, green, blue] = drawing::colour(agent);
        let wanted = PremultipliedColorU8::from_rgba(red, green, blue, 255).unwrap();
        assert!(picture.pixels().contains(&wanted), "{agent:?}");
    }
}

#[test]
fn of_every_task_each_agent_drives_as_many_links_as_it_has_joints() {
    for task in sim::task_names() {
        let config = RunConfig::with(&[task]).unwrap();
        let world = sim::environments(&config.task, 1).unwrap();
        let pose = world.pose(0);
        // A game has nothing to draw.
        let Some(robot) = RobotShapes::of(&*world) else { continue };
        assert_eq!(robot.drivers.len(), pose.links.len(), "{task}");
        assert!(pose.joints.iter().all(|joint| joint.link < pose.links.len()), "{task}");
        for (index, agent) in world.description().agents.iter().enumerate() {
            let driven = robot.drivers.iter().filter(|driver| **driver == Some(index)).count();
            assert_eq!(driven, agent.joints.len(), "{task} {}", agent.name);
        }
    }
}
