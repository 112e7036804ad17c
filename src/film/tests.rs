//! What is drawn where, of robots made up for it.

use sim::{JointPose, LinkPose, LinkShape, Pose, Shape, link_colour};
use tiny_skia::{Pixmap, PremultipliedColorU8};

use super::*;
use crate::config::run_config::RunConfig;
use crate::figures::style::Rgb;

const SIDE: Camera =
    Camera { view: ViewDirection::Side, on: [7.0, 0.0], pixels_per_metre: 150.0, has_floor: true };

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
        parent: None,
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
    let drivers = vec![None, Some(0), Some(1)];
    (RobotShapes { shapes, fixed: Vec::new(), floor: Some(0.0), drivers, agents: 2 }, pose)
}

fn seen(picture: &Pixmap, camera: &Camera, point: [f32; 2]) -> Rgb {
    let (x, y) = camera.pixel(point);
    let pixel = picture.pixel(x as u32, y as u32).unwrap().demultiply();
    [pixel.red(), pixel.green(), pixel.blue()]
}

#[test]
fn a_link_is_drawn_where_it_is_in_the_colour_of_its_agent_and_nothing_far_from_it() {
    let (robot, pose) = two_legs();
    let picture = drawing::panel(&drawing::capsules(&robot, &pose, ViewDirection::Side), &SIDE);
    let empty = drawing::panel(&[], &SIDE);
    // The ends of the left leg's middle line, then a point within its round upper end.
    for point in [[6.5, 0.2], [6.5, 0.8], [6.5, 0.88]] {
        assert_eq!(seen(&picture, &SIDE, point), link_colour(Some(0)), "{point:?}");
    }
    assert_eq!(seen(&picture, &SIDE, [7.0, 1.0]), link_colour(None));
    assert_eq!(seen(&picture, &SIDE, [7.5, 0.5]), link_colour(Some(1)));
    let colours = [link_colour(Some(0)), link_colour(Some(1)), link_colour(None)];
    assert!(colours[0] != colours[1] && colours[1] != colours[2] && colours[0] != colours[2]);
    for point in [[6.5, 0.95], [6.35, 0.5], [7.0, 0.5], [8.2, 1.4], [7.0, -0.1]] {
        assert_eq!(seen(&picture, &SIDE, point), seen(&empty, &SIDE, point), "{point:?}");
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
    let picture = drawing::panel(&drawing::capsules(&robot, &pose, ViewDirection::Side), &SIDE);
    let empty = drawing::panel(&[], &SIDE);
    assert_eq!(seen(&picture, &SIDE, [6.5, 0.5]), link_colour(Some(0)));
    assert_eq!(seen(&picture, &SIDE, [6.5, 0.8]), seen(&empty, &SIDE, [6.5, 0.8]));
}

#[test]
fn what_is_fixed_is_drawn_behind_the_robot_and_does_not_change_the_scale() {
    let (mut robot, pose) = two_legs();
    let frame = [TimedPose { time_secs: 0.0, pose: &pose }];
    let without = views(&robot, &frame, ViewDirection::Side).remove(0);
    // A bar from far on the left to the right leg, nearer to the viewer than the robot.
    robot.fixed = vec![Capsule { ends: [[0.0, -1.0, 0.5], [7.5, -1.0, 0.5]], radius: 0.05 }];
    let with = views(&robot, &frame, ViewDirection::Side).remove(0);
    assert_eq!(with.0.pixels_per_metre, without.0.pixels_per_metre);
    let [with, without] = [with, without].map(|(camera, capsules)| {
        let picture = drawing::panel(&capsules, &camera);
        [6.5, 7.0].map(|x| seen(&picture, &camera, [x, 0.5]))
    });
    assert_eq!(with, [link_colour(Some(0)), link_colour(None)]);
    assert_eq!(without[0], with[0]);
    assert_ne!(without[1], with[1]);
}

#[test]
fn a_strip_is_as_large_as_it_says_and_shows_every_agent() {
    let (robot, pose) = two_legs();
    let frames: Vec<_> =
        (0..5).map(|k| TimedPose { time_secs: f64::from(k), pose: &pose }).collect();
    let picture =
        Pixmap::decode_png(&strip(&robot, &frames, ViewDirection::Side).unwrap()).unwrap();
    assert_eq!((picture.width(), picture.height()), size(5, 2));
    for agent in [Some(0), Some(1), None] {
        let [red, green, blue] = link_colour(agent);
        let wanted = PremultipliedColorU8::from_rgba(red, green, blue, 255).unwrap();
        assert!(picture.pixels().contains(&wanted), "{agent:?}");
    }
}

/// The robot two metres further in each frame.
fn walk(count: u8, pose: &Pose) -> Vec<Pose> {
    let moved = |index| {
        let mut pose = pose.clone();
        pose.links.iter_mut().for_each(|link| link.position[0] += 2.0 * f32::from(index));
        pose
    };
    (0..count).map(moved).collect()
}

#[test]
fn a_gif_repeats_the_same_frames_for_ever_at_their_times_with_the_robot_in_the_middle() {
    let (robot, pose) = two_legs();
    let poses = walk(4, &pose);
    let frames: Vec<_> = poses.iter().map(|pose| TimedPose { time_secs: 0.0, pose }).collect();
    let animation = || Animation::of(&robot, &frames, ViewDirection::Side, 0.025).unwrap();
    let bytes = animation().gif().unwrap();
    assert_eq!(bytes, animation().gif().unwrap());
    let mut decoder = gif::Decoder::new(bytes.as_slice()).unwrap();
    assert_eq!((decoder.width(), decoder.height()), (480, 300));
    assert_eq!(decoder.repeat(), gif::Repeat::Infinite);
    let palette = decoder.global_palette().unwrap().to_vec();
    let mut shown = vec![0; 480 * 300];
    let mut delays = Vec::new();
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        delays.push(frame.delay);
        let changed = frame.buffer.iter().enumerate().filter(|(_, index)| **index != 0);
        changed.for_each(|(place, index)| shown[place] = *index);
        let seen = |x: usize, y: usize| {
            let index = 3 * usize::from(shown[y * 480 + x]);
            [palette[index], palette[index + 1], palette[index + 2]]
        };
        // The root is a ball around one metre above the floor, at the largest scale at which it fits.
        let scale = 220.0 / 1.2;
        assert_eq!(seen(240, 236 - scale as usize), link_colour(None));
        let leg = (0.5 * scale) as usize;
        assert_eq!(seen(240 - leg, 236 - leg), link_colour(Some(0)));
        assert_eq!(seen(240 + leg, 236 - leg), link_colour(Some(1)));
    }
    assert_eq!(delays, [3, 2, 3, 2]);
}

#[test]
fn an_obliquely_seen_robot_has_a_shadow_below_it() {
    let (robot, pose) = two_legs();
    let camera = Camera { view: ViewDirection::ThreeQuarter, ..SIDE };
    let capsules = drawing::capsules(&robot, &pose, camera.view);
    let picture = drawing::panel(&capsules, &camera);
    let empty = drawing::panel(&[], &camera);
    let on_floor = camera.view.plane([7.0, 0.0, 0.0]);
    assert_ne!(seen(&picture, &camera, on_floor), seen(&empty, &camera, on_floor));
    let root = camera.view.plane([7.0, 0.0, 1.0]);
    assert_eq!(seen(&picture, &camera, root), link_colour(None));
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
