//! Attributes that models of robots use, with the numbers that MuJoCo 4.0.0 has for them.

use super::{assert_near, document, motion, robot, robot_with, unsigned, world_of};
use crate::robot::{Physics, Robot};

/// Corners of a tetrahedron, m.
const CORNERS: &str = "0 0 0 1 0 0 0 2 0 0 0 3";

/// Parts of a free body, and its start and end as coordinates.
const ALIGNED: [(&str, [f32; 7], [f32; 7]); 8] = [
    (
        "<geom type=\"box\" size=\".1 .2 .3\" pos=\".4 .1 0\" euler=\"1 2 3\"/>",
        [1.380284, 2.155987, 2.967561, -0.491355, 0.743562, -0.264616, 0.368326],
        [1.400284, 2.195987, 2.71038, -0.614828, 0.488782, -0.509107, 0.351979],
    ),
    (
        "<geom type=\"box\" size=\".1 .2 .3\" pos=\".4 .1 0\" euler=\"1 2 3\"/>\
         <geom size=\".1\" pos=\"-.2 .1 .3\"/>",
        [1.338106, 2.141607, 2.997779, -0.366139, 0.801404, -0.309664, 0.357495],
        [1.358106, 2.181607, 2.740598, -0.505863, 0.542419, -0.541976, 0.395154],
    ),
    (
        "<geom type=\"capsule\" size=\".1\" fromto=\"0 0 .1 .3 .2 -.4\"/>",
        [1.106691, 2.160983, 2.866953, 0.931493, 0.329775, -0.153399, 0.006195],
        [1.126691, 2.200983, 2.609772, 0.841921, 0.400551, -0.084001, 0.351671],
    ),
    (
        "<frame pos=\".1 0 0\" euler=\"0 .5 0\">\
         <geom type=\"mesh\" mesh=\"m\" pos=\"0 .1 0\" quat=\"1 .2 .3 .4\"/></frame>",
        [1.157614, 2.145825, 3.066083, 0.568765, 0.570918, 0.448701, 0.386298],
        [1.177614, 2.185825, 2.808902, 0.264052, 0.675567, 0.386224, 0.56984],
    ),
    (
        "<geom type=\"box\" mesh=\"m\" pos=\"0 .1 0\" quat=\"1 .2 .3 .4\"/>",
        [1.033454, 2.118152, 3.110795, 0.672049, 0.511396, 0.248258, 0.474545],
        [1.053454, 2.158152, 2.853614, 0.373885, 0.55768, 0.246396, 0.698922],
    ),
    (
        "<geom type=\"mesh\" mesh=\"m\" pos=\"0 .1 0\"/>\
         <geom type=\"mesh\" mesh=\"m\" pos=\".3 0 0\" quat=\"1 1 0 0\"/>",
        [1.179403, 2.044238, 3.04237, 0.393073, 0.798996, 0.237783, 0.388019],
        [1.199403, 2.084238, 2.785189, 0.094799, 0.807734, 0.108627, 0.571645],
    ),
    (
        "<inertial pos=\".1 .2 .3\" quat=\"1 .5 0 .2\" mass=\"2\" diaginertia=\".1 .2 .15\"/>\
         <geom size=\".1\"/>",
        [1.137549, 2.117431, 3.327552, 0.785646, 0.583386, 0.081446, 0.189177],
        [1.157549, 2.157431, 3.070371, 0.589257, 0.624016, 0.10172, 0.503024],
    ),
    (
        "<inertial pos=\".1 .2 .3\" mass=\"2\" fullinertia=\".1 .2 .15 .01 .02 -.03\"/>\
         <geom size=\".1\"/>",
        [1.137549, 2.117431, 3.327552, 0.336634, 0.550402, 0.693194, 0.321275],
        [1.157549, 2.157431, 3.070371, 0.03454, 0.709087, 0.570279, 0.41326],
    ),
];

/// A document with these bodies, and sections before them.
fn with(sections: &str, bodies: &str) -> String {
    document(bodies, "").replace("<worldbody>", &format!("{sections}<worldbody>"))
}

/// Mass, mass centre and ascending principal moments of the first link.
fn weight(robot: &Robot) -> [f32; 7] {
    let mass = &robot.blueprint.links[0].mass;
    let ([x, y, z], mut moments) = (mass.local_com.to_array(), mass.principal_inertia().to_array());
    moments.sort_by(f32::total_cmp);
    let [low, middle, high] = moments;
    [mass.mass(), x, y, z, low, middle, high]
}

/// Coordinates after these steps of a millisecond from these velocities, without controls.
fn moved(mjcf: &str, speeds: &[f32], steps: usize) -> Vec<f32> {
    let mut world = world_of(mjcf);
    let rest = world.robot().rest().to_vec();
    world.rebuild(&rest, speeds);
    for _ in 0..steps {
        assert!(world.step(&[]));
    }
    motion(&world).0
}

#[test]
fn the_surface_of_a_shape_with_shellinertia_has_its_mass() {
    let sections = format!(
        "<default><geom shellinertia=\"true\" density=\"5\"/></default>\
         <asset><mesh name=\"m\" vertex=\"{CORNERS}\"/></asset>"
    );
    for (shape, expected) in [
        ("size=\".1\"", [0.628_318_5, 0.0, 0.0, 0.0, 0.004_188_8, 0.004_188_8, 0.004_188_8]),
        (
            "type=\"capsule\" size=\".1 .2\"",
            [1.884_955_6, 0.0, 0.0, 0.0, 0.016_755_2, 0.064_926_2, 0.064_926_2],
        ),
        (
            "type=\"cylinder\" size=\".1 .2\"",
            [std::f32::consts::FRAC_PI_2, 0.0, 0.0, 0.0, 0.014_137_2, 0.036_390_1, 0.036_390_1],
        ),
        (
            "type=\"box\" size=\".1 .2 .3\"",
            [4.4, 0.0, 0.0, 0.0, 0.121_333_3, 0.210_666_7, 0.270_666_7],
        ),
        (
            "type=\"ellipsoid\" size=\".1 .2 .3\"",
            [2.448_596_7, 0.0, 0.0, 0.0, 0.040_513_4, 0.070_341_8, 0.090_375_9],
        ),
        (
            "type=\"box\" size=\".1 .2 .3\" mass=\"2\"",
            [2.0, 0.0, 0.0, 0.0, 0.055_151_5, 0.095_757_6, 0.123_030_3],
        ),
        (
            "type=\"capsule\" size=\".05\" fromto=\"0 0 0 .1 .2 .3\"",
            [0.744_817_8, 0.05, 0.1, 0.15, 0.001_731_1, 0.014_820_5, 0.014_820_5],
        ),
        (
            "type=\"box\" mesh=\"m\"",
            [44.364_47, 0.25, 0.5, 0.75, 11.231_474, 23.319_574, 30.135_088],
        ),
    ] {
        let body = format!("<body><freejoint/><geom {shape}/></body>");
        let found = weight(&robot(&with(&sections, &body)).unwrap());
        let largest = expected.iter().copied().fold(0.0, f32::max);
        assert_near(shape, &found, &expected, 2e-6 * largest.max(0.1));
    }
    let mesh = "<body><freejoint/><geom type=\"mesh\" mesh=\"m\"/></body>";
    let reason = robot(&with(&sections, mesh)).err().unwrap();
    assert!(reason.contains("a mesh has no `shellinertia`; remove it"), "{reason}");
}

#[test]
fn the_surface_of_a_mesh_with_the_inertia_of_a_shell_has_its_mass() {
    let body = "<body><freejoint/><geom type=\"mesh\" mesh=\"m\" density=\"5\"/></body>";
    let solid = [5.0, 0.25, 0.5, 0.75, 0.794_588, 1.943_074, 2.512_338];
    let shell = [45.0, 0.222_222, 0.555_556, 0.888_889, 11.465_327, 28.546_692, 36.654_648];
    for (inertia, expected) in
        [("shell", shell), ("legacy", solid), ("exact", solid), ("convex", solid)]
    {
        let sections = format!(
            "<default><mesh inertia=\"{inertia}\"/></default><asset><mesh name=\"m\" \
             vertex=\"{CORNERS} .3 .2 .5\" face=\"0 2 1 0 1 3 1 2 3 0 3 2\"/></asset>"
        );
        let found = weight(&robot(&with(&sections, body)).unwrap());
        assert_near(inertia, &found, &expected, 2e-6 * expected[0]);
    }
}

#[test]
fn moments_that_no_body_can_have_are_balanced_to_their_mean() {
    let balance = "<compiler balanceinertia=\"true\"/>";
    for moments in
        ["diaginertia=\".1 .2 .6\" quat=\"1 .3 0 0\"", "fullinertia=\".1 .2 .6 .01 .02 -.03\""]
    {
        let body = format!(
            "<body><freejoint/><inertial pos=\".1 0 .2\" mass=\"2\" {moments}/><geom size=\".1\"/></body>"
        );
        let found = weight(&robot(&with(balance, &body)).unwrap());
        assert_near(moments, &found, &[2.0, 0.1, 0.0, 0.2, 0.3, 0.3, 0.3], 1e-6);
        let reason = robot(&with("", &body)).err().unwrap();
        assert!(reason.contains("none may exceed the sum of the others"), "{reason}");
    }
    // Possible moments remain.
    let body = "<body><freejoint/><inertial pos=\"0 0 0\" mass=\"2\" diaginertia=\".1 .2 .25\"/>\
        <geom size=\".1\"/></body>";
    let found = weight(&robot(&with(balance, body)).unwrap());
    assert_near("possible", &found, &[2.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.25], 1e-6);
}

/// In MuJoCo the start is `qpos0`, the end `qpos` after 0.2 s with the velocities 0.1, 0.2 and -0.3 m/s and 1, 2 and 3 rad/s
/// about the axes of the body, which are those of its inertia.
#[test]
fn the_frame_of_an_aligned_free_body_is_that_of_its_inertia() {
    let asset = format!(
        "<asset><mesh name=\"m\" vertex=\"{CORNERS}\" scale=\".1 .1 .1\" inertia=\"exact\"/></asset>"
    );
    for (parts, start, end) in ALIGNED {
        let place = "pos=\"1 2 3\" euler=\"0.3 0.2 0.1\"";
        let mjcf =
            with(&asset, &format!("<body {place}><freejoint align=\"true\"/>{parts}</body>"));
        let built = robot(&mjcf).unwrap();
        assert_near(parts, &unsigned(built.rest()), &unsigned(&start), 5e-6);
        // Velocities of a free joint are about the axes of the world.
        let turn = [start[4], start[5], start[6], start[3]];
        let [x, y, z] = crate::scene::rotated(turn, [1.0, 2.0, 3.0]);
        let found = moved(&mjcf, &[0.1, 0.2, -0.3, x, y, z], 200);
        assert_near(parts, &unsigned(&found), &unsigned(&end), 1e-4);
    }
}

#[test]
fn only_free_bodies_without_children_are_aligned_and_not_against_their_joint() {
    let parts = "<geom type=\"box\" size=\".1 .2 .03\" pos=\".1 0 .05\" euler=\".4 .5 .6\"/>";
    let own = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0];
    let aligned = [0.1, 0.0, 1.05, 0.892_661, 0.255_551, 0.174_757, 0.327_582];
    let child = "<body pos=\"0 0 .1\"><geom size=\".01\"/></body>";
    for (compiler, joint, child, expected) in [
        ("alignfree=\"true\"", "<freejoint/>", "", aligned),
        ("alignfree=\"true\"", "<joint type=\"free\"/>", "", aligned),
        ("alignfree=\"true\"", "<freejoint align=\"auto\"/>", "", aligned),
        ("alignfree=\"true\"", "<freejoint align=\"false\"/>", "", own),
        ("alignfree=\"true\"", "<freejoint/>", child, own),
        ("alignfree=\"false\"", "<freejoint/>", "", own),
        ("", "<freejoint align=\"true\"/>", "", aligned),
        ("", "<freejoint align=\"true\"/>", child, own),
    ] {
        let compiler = format!("<compiler {compiler}/>");
        let body = format!("<body pos=\"0 0 1\">{joint}{parts}{child}</body>");
        let built = robot(&with(&compiler, &body)).unwrap();
        let what = format!("{compiler} {joint} {child}");
        assert_near(&what, &unsigned(built.rest()), &expected, 5e-6);
    }
    let empty = "<body><freejoint align=\"true\"/><geom size=\".1\" mass=\"0\"/></body>";
    let reason = robot(&with("", empty)).err().unwrap();
    assert!(reason.contains("it has no mass; state its `inertial`, or set align="), "{reason}");
}

/// In MuJoCo, the keyframe is one of the aligned frame, and the site stays where it is in the world.
#[test]
fn keyframes_are_those_of_the_aligned_frame_and_sites_stay_at_their_places() {
    let bodies = "<site name=\"b\" pos=\".3 0 1\"/><body name=\"q\" pos=\"0 0 1\"><freejoint align=\"true\"/>\
        <geom type=\"box\" size=\".1 .2 .03\" pos=\".1 0 .05\" euler=\".4 .5 .6\"/><site name=\"a\" pos=\".3 0 0\"/></body>";
    let sections = "<equality><connect site1=\"a\" site2=\"b\"/></equality>\
        <keyframe><key qpos=\"0 0 2 1 0 0 0\"/></keyframe></mujoco>";
    let mjcf = document(bodies, "").replace("</mujoco>", sections);
    let built = robot(&mjcf).unwrap();
    assert_eq!(built.blueprint.keyframes[0].positions, [0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]);
    let found = moved(&mjcf, &[0.0; 6], 200);
    let expected = [0.122319, 0.017417, 0.896312, 0.835810, 0.272237, -0.241662, 0.410985];
    assert_near("hanging", &unsigned(&found), &expected, 1e-3);
}

/// After 0.2 s.
#[test]
fn gravity_compensation_counts_for_the_range_of_the_joint_if_it_is_a_force_of_actuators() {
    let free = [0.15675, 0.831242];
    let limited = [-0.228542, 0.36796];
    for (joint, integrator, expected, efforts) in [
        ("", "Euler", free, [1.0, -1.606728]),
        ("actuatorfrcrange=\"-2 2\"", "Euler", free, [1.0, -1.606728]),
        ("actuatorgravcomp=\"true\"", "Euler", free, [5.015031, -1.988922]),
        (
            "actuatorfrcrange=\"-9 9\" actuatorgravcomp=\"true\"",
            "Euler",
            free,
            [5.015031, -1.988922],
        ),
        ("actuatorfrcrange=\"-2 2\" actuatorgravcomp=\"true\"", "Euler", limited, [2.0, -0.621472]),
        (
            "actuatorfrcrange=\"-2 2\" actuatorgravcomp=\"true\"",
            "implicitfast",
            limited,
            [2.0, -0.621472],
        ),
        (
            "actuatorfrcrange=\"-2 2\" actuatorgravcomp=\"true\"",
            "RK4",
            [-0.225286, 0.369273],
            [2.0, -0.614148],
        ),
    ] {
        let mut world = world_of(&format!(
            "<mujoco><compiler angle=\"radian\"/><option timestep=\".002\" integrator=\"{integrator}\"/>\
             <default><joint {joint}/><geom contype=\"0\" conaffinity=\"0\"/></default><worldbody>\
             <body pos=\"0 0 1\" gravcomp=\"1\"><joint name=\"a\" axis=\"0 -1 0\" damping=\".1\"/>\
             <geom size=\".05\" pos=\".3 0 0\" mass=\"1\"/><body pos=\".3 0 0\" gravcomp=\".5\">\
             <joint name=\"b\" axis=\"0 1 0\"/><geom size=\".05\" pos=\".2 0 0\" mass=\".5\"/></body></body></worldbody>\
             <actuator><motor joint=\"a\" gear=\"2\" ctrlrange=\"-1 1\"/>\
             <position joint=\"b\" kp=\"3\" ctrlrange=\"-1 1\"/></actuator></mujoco>"
        ));
        for _ in 0..100 {
            assert!(world.step(&[0.5, 0.3]));
        }
        let what = format!("{joint} {integrator}");
        assert_near(&what, &motion(&world).0, &expected, 1e-4);
        assert_near(&what, &world.efforts().collect::<Vec<_>>(), &efforts, 0.02);
    }
}

#[test]
fn the_engines_solver_is_refused_where_gravity_compensation_is_a_force_of_actuators() {
    let physics = Physics { contact_compliance: Some(0.1), ..Physics::default() };
    let body = "<body><joint actuatorgravcomp=\"true\" actuatorfrcrange=\"-1 1\"/><geom size=\".1\"/></body>";
    let built = robot_with(&with("", body), physics, &|path| Err(path.to_owned()));
    let reason = built.err().unwrap();
    assert!(reason.contains("needs a model without `actuatorgravcomp`; remove it"), "{reason}");
}

#[test]
fn the_engines_solver_says_that_it_has_no_friction_against_spinning_and_rolling() {
    for (condim, expected) in [("3", 0), ("4", 1), ("6", 1)] {
        let mjcf = format!(
            "<mujoco><worldbody><geom type=\"plane\" size=\"1 1 1\"/><body pos=\"0 0 .2\"><freejoint/>\
             <geom size=\".1\" condim=\"{condim}\"/></body></worldbody></mujoco>"
        );
        let physics = Physics { contact_compliance: Some(0.1), ..Physics::default() };
        let robot = robot_with(&mjcf, physics, &|path| Err(path.to_owned())).unwrap();
        let left_out = robot.left_out().iter().filter(|what| what.contains("spinning and rolling"));
        assert_eq!(left_out.count(), expected, "{condim}");
    }
}

/// After 0.1 s.
#[test]
fn the_friction_of_a_pair_has_its_own_damping_in_an_elliptic_cone() {
    let default = [0.00099, 0.000496, 0.099892];
    let pyramid = [0.001053, 0.000536, 0.099894];
    for (cone, pair, expected) in [
        ("elliptic", "", default),
        ("elliptic", "solreffriction=\"0 0\"", default),
        ("elliptic", "solreffriction=\"0.2 1\"", [0.006281, 0.003141, 0.099891]),
        ("elliptic", "solreffriction=\"-10 -3\"", [0.008623, 0.004312, 0.099891]),
        ("pyramidal", "solreffriction=\"0.2 1\"", pyramid),
    ] {
        let mjcf = format!(
            "<mujoco><option timestep=\".001\" cone=\"{cone}\"/><default><pair {pair}/></default><worldbody>\
             <geom name=\"f\" type=\"plane\" size=\"1 1 1\"/><body pos=\"0 0 .1\"><freejoint/>\
             <geom name=\"b\" type=\"box\" size=\".1 .1 .1\"/></body></worldbody>\
             <contact><pair geom1=\"f\" geom2=\"b\" condim=\"3\" friction=\"1 1\"/></contact></mujoco>"
        );
        let found = moved(&mjcf, &[0.1, 0.05, 0.0, 0.0, 0.0, 0.0], 100);
        assert_near(&format!("{cone} {pair}"), &found[..3], &expected, 2e-4);
    }
}

/// After 0.1 s.
#[test]
fn a_connected_site_between_two_points_is_in_their_middle_and_points_from_the_second_to_the_first()
{
    for (equality, expected) in [
        ("connect", [-0.052041, -0.031772, 0.903667, 0.998989, 0.0297, 0.00604, -0.033191]),
        ("weld", [-0.028637, -0.042152, 0.877793, 0.970941, 0.194549, -0.025218, 0.137069]),
    ] {
        let mjcf = format!(
            "<mujoco><compiler angle=\"radian\"/><default><site type=\"capsule\"/></default>\
             <option timestep=\".001\"/><worldbody><site name=\"b\" pos=\".1 0 1\" euler=\".1 .2 .3\"/>\
             <body pos=\"0 0 1\"><freejoint/><geom type=\"box\" size=\".1 .2 .03\"/>\
             <site name=\"a\" fromto=\".2 .1 .3 .1 0 -.1\"/></body></worldbody>\
             <equality><{equality} site1=\"a\" site2=\"b\"/></equality></mujoco>"
        );
        assert_near(equality, &unsigned(&moved(&mjcf, &[0.0; 6], 100)), &expected, 2e-3);
    }
}

#[test]
fn a_site_whose_two_points_do_not_decide_its_place_is_refused() {
    for (site, expected) in [
        ("type=\"capsule\" pos=\"0 0 1\"", "has both `pos` and `fromto`; remove one"),
        ("", "a shape of the type `sphere` has no `fromto`; remove it"),
    ] {
        let body = format!(
            "<body><freejoint/><geom size=\".1\"/><site {site} fromto=\"0 0 0 1 0 0\"/></body>"
        );
        let reason = robot(&with("", &body)).err().unwrap();
        assert!(reason.contains("line 3, <site>") && reason.contains(expected), "{reason}");
    }
}

/// MuJoCo takes the position of a body without a mass in its parent as its mass centre, in the body's own frame. The softness
/// of its connections depends on that point. After 0.2 s.
#[test]
fn a_connection_of_a_body_without_a_mass_is_as_soft_as_in_mujoco() {
    for (place, equality, expected) in [
        (
            ".3 0 .2",
            "connect body1=\"hand\" body2=\"world\" anchor=\"0 0 0\"",
            [0.164644, -0.276234],
        ),
        (".3 0 .2", "weld body1=\"world\" body2=\"hand\"", [0.122721, -0.16774]),
        (
            ".1 0 .7",
            "connect body1=\"hand\" body2=\"world\" anchor=\"0 0 0\"",
            [0.278855, -0.261306],
        ),
    ] {
        let mjcf = format!(
            "<mujoco><option timestep=\".001\"/><worldbody><body pos=\"0 0 1\"><joint axis=\"0 1 0\"/>\
             <geom type=\"capsule\" size=\".03\" fromto=\"0 0 0 .4 0 0\"/><body pos=\".4 0 0\">\
             <joint axis=\"0 1 0\"/><geom type=\"capsule\" size=\".03\" fromto=\"0 0 0 .3 0 0\"/>\
             <body name=\"hand\" pos=\"{place}\"><geom size=\".02\" mass=\"0\" contype=\"0\" conaffinity=\"0\"/>\
             </body></body></body></worldbody><equality><{equality} solref=\".1 1\"/></equality></mujoco>"
        );
        assert_near(equality, &moved(&mjcf, &[0.0; 2], 200), &expected, 1e-4);
    }
}
