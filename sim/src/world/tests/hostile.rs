//! Models with absurd numbers, unknown attributes and repeated names: each is refused with what is wrong, or moves without
//! NaN.

use std::sync::Arc;

use super::{LOPSIDED, World, document, robot};

/// A model with every element and number that is read.
const EVERYTHING: &str = r#"<mujoco model="all">
<compiler angle="radian" boundmass="0.001" boundinertia="1e-6" settotalmass="20" inertiagrouprange="0 5"/>
<option timestep="0.002" gravity="0 0 -9.81" cone="elliptic" impratio="2"/>
<option><flag energy="enable"/></option>
<default><default class="soft"><geom solimp="0.9 0.95 0.001 0.5 2"/></default></default>
<asset>
<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" scale="0.1 0.1 0.1"/>
<hfield name="field" nrow="2" ncol="2" size="1 1 0.1 0.1" elevation="0 0.1 0.2 0.3"/>
</asset>
<worldbody>
<geom name="floor" type="plane" size="1 1 1"/>
<geom type="hfield" hfield="field" pos="5 0 0"/>
<frame pos="0 0 0.1" euler="0 0 0.1">
<body name="trunk" pos="0 0 0.5" quat="1 0 0 0" gravcomp="0">
<freejoint name="root"/>
<inertial pos="0 0 0" mass="3" diaginertia="0.1 0.1 0.1"/>
<geom name="box" class="soft" type="box" size="0.1 0.2 0.1" pos="0 0 0" zaxis="0 0 1"/>
<body name="arm" pos="0.3 0 0" axisangle="0 0 1 0.2">
<joint name="j" pos="0 0 0" axis="0 1 0" range="-1 1" stiffness="1" springref="0.1" damping="0.2" armature="0.01" frictionloss="0.1" ref="0.1" margin="0.01" solreflimit="0.02 1" solimplimit="0.9 0.95 0.001" solreffriction="0.02 1" solimpfriction="0.9 0.95 0.001" actuatorfrcrange="-50 50" actuatorgravcomp="true"/>
<geom name="bar" type="capsule" size="0.05" fromto="0 0 0 0.3 0 0" density="800" friction="0.9 0.01 0.01" margin="0.001" solmix="1" solref="0.02 1" condim="6" priority="1" contype="1" conaffinity="1" group="1"/>
<body name="hand" pos="0.4 0 0" xyaxes="1 0 0 0 1 0">
<joint name="k" type="slide" axis="1 0 0" range="-0.1 0.1" springdamper="0.5 1"/>
<geom type="mesh" mesh="m" mass="0.5"/>
</body></body></body></frame></worldbody>
<contact>
<pair geom1="floor" geom2="bar" condim="3" friction="1 1 0.01 0.01 0.01" solref="0.02 1" solreffriction="0.1 1" solimp="0.9 0.95 0.001 0.5 2" margin="0.001"/>
<exclude body1="trunk" body2="hand"/>
</contact>
<tendon><fixed name="t" range="-1 1" stiffness="1" damping="1" springlength="0 0.1" frictionloss="0.1" margin="0.01" solreflimit="0.02 1" solimplimit="0.9 0.95 0.001">
<joint joint="j" coef="1"/><joint joint="k" coef="0.5"/></fixed></tendon>
<equality>
<joint joint1="j" joint2="k" polycoef="0.1 2 0 0 0" solref="0.05 1" solimp="0.9 0.95 0.001"/>
<tendon tendon1="t" polycoef="0 0 0 0 0" solref="0.05 1"/>
<connect body1="hand" body2="trunk" anchor="0 0 0" solref="0.05 1"/>
<weld body1="hand" body2="trunk" anchor="0 0 0" relpose="-0.7 0 0 1 0 0 0.1" torquescale="0.5" solref="0.05 1"/>
</equality>
<actuator>
<motor name="m1" joint="j" gear="10" ctrlrange="-1 1"/>
<position joint="k" kp="100" dampratio="1" timeconst="0.1" inheritrange="0.9" forcerange="-50 50"/>
<velocity joint="k" kv="10" ctrlrange="-1 1"/>
<general tendon="t" gainprm="10" biastype="affine" biasprm="0 -10 -1" dyntype="filter" dynprm="0.1" actrange="-1 1" actearly="true" ctrlrange="-1 1"/>
</actuator>
<keyframe><key name="home" qpos="0 0 0.6 1 0 0 0 0 0" qvel="0 0 0 0 0 0 0 0" ctrl="0 0 0 0" act="0 0" time="0"/></keyframe>
</mujoco>"#;

/// Numbers in the place of those of the model.
const NUMBERS: [&str; 11] =
    ["1e30", "-1e30", "1e38", "1e300", "nan", "inf", "x", "1e-30", "1e-44", "-1", "0"];

/// The attributes of the model: element, name, and the bytes of the value.
fn attributes() -> Vec<(&'static str, &'static str, std::ops::Range<usize>)> {
    let mut found = Vec::new();
    for (at, _) in EVERYTHING.match_indices("=\"") {
        let name = EVERYTHING[..at].rsplit(' ').next().unwrap();
        let tag = EVERYTHING[..at].rsplit('<').next().unwrap();
        let tag = tag.split(' ').next().unwrap();
        let length = EVERYTHING[at + 2..].find('"').unwrap();
        found.push((tag, name, at + 2..at + 2 + length));
    }
    found
}

/// The model with another value in the place of one.
fn with(place: &std::ops::Range<usize>, value: &str) -> String {
    let mut model = EVERYTHING.to_owned();
    model.replace_range(place.clone(), value);
    model
}

/// Builds a model and moves it for some steps with its largest controls. Its numbers stay finite, unless a step says that
/// it failed.
fn moves(mjcf: &str) -> Result<(), String> {
    let robot = robot(mjcf)?;
    let controls: Vec<f32> = robot.actuators().map(|motor| motor.control[1]).collect();
    let mut world = World::new(Arc::new(robot));
    for _ in 0..10 {
        if !world.step(&controls) {
            return Ok(());
        }
    }
    let (at, speeds) = super::motion(&world);
    assert!(at.iter().chain(&speeds).all(|number| !number.is_nan()), "{at:?} {speeds:?}\n{mjcf}");
    Ok(())
}

#[test]
fn an_absurd_number_of_any_attribute_is_refused_by_its_name_or_does_no_harm() {
    moves(EVERYTHING).unwrap();
    let is_number = |text: &str| text.split(' ').all(|part| part.parse::<f64>().is_ok());
    let places =
        attributes().into_iter().filter(|(.., place)| is_number(&EVERYTHING[place.clone()]));
    let (mut seen, mut wrong) = (0, Vec::new());
    for (tag, name, place) in places {
        let value = &EVERYTHING[place.clone()];
        let count = value.split(' ').count();
        let numbers = NUMBERS.map(|number| vec![number; count].join(" "));
        let lengths = [String::new(), format!("{value} 1 1 1 1 1 1 1 1 1 1 1 1")];
        for text in numbers.into_iter().chain(lengths) {
            seen += 1;
            let Err(reason) = moves(&with(&place, &text)) else { continue };
            // The mass of a body follows from several attributes, and an empty one counts as none.
            let follows = text.is_empty() || reason.contains("must have a mass");
            let is_named = reason.contains(name) || follows;
            if !is_named || reason.contains('\n') {
                wrong.push(format!("<{tag} {name}=\"{text}\">: {reason}"));
            }
        }
    }
    assert!(wrong.is_empty() && seen > 900, "{seen}\n{}", wrong.join("\n"));
}

#[test]
fn every_element_refuses_an_attribute_that_it_does_not_have() {
    for (at, _) in
        EVERYTHING.match_indices('<').filter(|(at, _)| !EVERYTHING[*at..].starts_with("</"))
    {
        let tag = EVERYTHING[at + 1..].split([' ', '>', '/']).next().unwrap();
        let mut model = EVERYTHING.to_owned();
        model.insert_str(at + 1 + tag.len(), " zz=\"1\"");
        let reason = robot(&model).err().unwrap_or_else(|| panic!("{tag} accepts any attribute"));
        assert!(reason.contains("the attribute `zz` is not supported"), "{tag}: {reason}");
    }
}

#[test]
fn a_name_that_is_taken_or_unknown_is_refused_with_what_to_write() {
    let twice = |element: &str| {
        let at = EVERYTHING.find(element).unwrap_or_else(|| panic!("no {element}"));
        let end = at + EVERYTHING[at..].find("/>").unwrap() + 2;
        with(&(end..end), &EVERYTHING[at..end])
    };
    let cases = [
        (twice("<geom name=\"box\""), "another element has the name `box`, too; rename one"),
        (twice("<joint name=\"j\""), "another element has the name `j`, too"),
        (twice("<motor name"), "another element has the name `m1`, too"),
        (twice("<key name"), "another element has the name `home`, too"),
        (EVERYTHING.replace("joint2=\"k\"", "joint2=\"j\""), "`joint1` and `joint2` are the same"),
        (
            EVERYTHING.replace("joint2=\"k\"", "joint2=\"kk\""),
            "no hinge or slide has the name `kk`; there are j, k",
        ),
        (EVERYTHING.replace("body2=\"trunk\"", "body2=\"hand\""), "connects a body with itself"),
        (
            EVERYTHING.replace("exclude body1=\"trunk\"", "exclude body1=\"trunc\""),
            "did you mean `trunk`?",
        ),
        (EVERYTHING.replace("geom2=\"bar\"", "geom2=\"barr\""), "did you mean `bar`?"),
        (EVERYTHING.replace("class=\"soft\" type", "class=\"sofa\" type"), "did you mean `soft`?"),
        (
            EVERYTHING.replace("body name=\"arm\"", "body name=\"world\""),
            "another element has the name `world`",
        ),
        (
            EVERYTHING.replace("name=\"k\"", "name=\"root.x\"").replace("\"k\"", "\"root.x\""),
            "two coordinates have the name `root.x`",
        ),
        (
            EVERYTHING.replace("name=\"k\"", "name=\"root.wx\"").replace("\"k\"", "\"root.wx\""),
            "two velocities have the name `root.wx`",
        ),
        (
            EVERYTHING.replace("name=\"root\"", "name=\"root\" align=\"maybe\""),
            "<freejoint name=\"root\">: align=\"maybe\" must be true or false",
        ),
        (
            EVERYTHING.replace("inertiagrouprange=\"0 5\"", "inertiagrouprange=\"5 2\""),
            "`inertiagrouprange` must ascend",
        ),
    ];
    for (model, expected) in cases {
        let reason = robot(&model).err().unwrap_or_else(|| panic!("built instead of: {expected}"));
        assert!(reason.contains(expected), "{reason}\ninstead of: {expected}");
    }
}

#[test]
fn actuators_without_a_name_have_names_of_their_own() {
    let names = |actuators: &str| {
        let robot = robot(&document(LOPSIDED, actuators)).unwrap();
        robot.actuators().map(|motor| motor.name.to_owned()).collect::<Vec<_>>()
    };
    let motor = "<motor joint=\"j\" ctrlrange=\"-1 1\"/>";
    let named = |name: &str| motor.replace("joint", &format!("name=\"{name}\" joint"));
    assert_eq!(names(motor), ["j"]);
    assert_eq!(names(&format!("{motor}{motor}{motor}")), ["j.motor", "j.motor.2", "j.motor.3"]);
    assert_eq!(
        names(&format!("{}{motor}{motor}", named("j.motor.2"))),
        ["j.motor.2", "j.motor", "j.motor.3"]
    );
    let other = LOPSIDED.replace(
        "<body pos=\"-0.2 0 0\">",
        "<body><joint name=\"a\"/><geom size=\"0.1\"/></body><body pos=\"-0.2 0 0\">",
    );
    let crossed = format!("<motor name=\"j\" joint=\"a\" ctrlrange=\"-1 1\"/>{motor}");
    let robot = robot(&document(&other, &crossed)).unwrap();
    let names: Vec<&str> = robot.actuators().map(|motor| motor.name).collect();
    assert_eq!(names, ["j", "j.motor"]);
}

#[test]
fn a_model_that_a_step_would_take_seconds_for_is_refused_before_it_is_built() {
    let arm = "<body><joint/><geom size=\"0.1\"/></body>";
    let geoms = format!("<body><joint name=\"j\"/>{}</body>", "<geom size=\"0.1\"/>".repeat(5001));
    let motors = "<motor joint=\"j\" ctrlrange=\"-1 1\"/>".repeat(1001);
    for (model, expected) in [
        (document(&arm.repeat(301), ""), "the model has 301 degrees of freedom, at most 300"),
        (document(&geoms, ""), "the model has 5002 shapes, at most 5000"),
        (document(LOPSIDED, &motors), "<actuator> has 1001 elements, at most 1000"),
    ] {
        let reason = robot(&model).err().unwrap();
        assert!(reason.contains(expected), "{reason}");
    }
}

#[test]
fn wrong_settings_are_listed_with_everything_else_that_is_wrong() {
    let model = EVERYTHING
        .replace("timestep=\"0.002\"", "timestep=\"0\"")
        .replace("cone=\"elliptic\"", "cone=\"round\"")
        .replace("angle=\"radian\"", "angle=\"turn\"")
        .replace("gravcomp=\"0\"", "gravcomp=\"x\"")
        .replace("<mesh name=\"m\"", "<mesh");
    let text = robot(&model).err().unwrap();
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    assert!(lines[0].ends_with("6 things are not supported:"), "{text}");
    let starts = [
        "(1) line 2, <compiler>: angle=",
        "(2) line 3, <option>: `timestep`",
        "(3) line 3, <option>: cone=",
    ];
    for (line, start) in lines[1..].iter().zip(starts) {
        assert!(line.starts_with(start), "{line} instead of {start}");
    }
    for (line, part) in lines[4..].iter().zip([
        "it has neither a name nor a file",
        "<body name=\"trunk\">: gravcomp=\"x\" must be finite",
        "<geom>: no mesh has the name `m`; there is none",
    ]) {
        assert!(line.contains(part), "{text}");
    }
}

/// The wall and the base are fixed: MuJoCo 4.0.0 has no contact between them, whatever their pair says.
#[test]
fn a_pair_of_two_fixed_shapes_is_no_contact() {
    let shapes = "<geom name=\"wall\" type=\"box\" size=\"1 1 1\"/><body name=\"base\"><geom name=\"foot\" size=\"0.2\"/>\
        <body pos=\"0 0 5\"><joint/><geom name=\"arm\" size=\"0.1\"/></body></body>";
    let pair = "<contact><pair geom1=\"wall\" geom2=\"foot\"/></contact></mujoco>";
    let mut world =
        World::new(Arc::new(robot(&document(shapes, "").replace("</mujoco>", pair)).unwrap()));
    for _ in 0..3 {
        assert!(world.step(&[]));
        assert_eq!(world.contact_impulse(), 0.0);
    }
}

/// Two bodies of `count` spheres each in one place have the square of `count` contacts.
#[test]
fn a_step_with_too_many_contacts_fails() {
    for (count, succeeds) in [(40, true), (50, false)] {
        let spheres = "<geom size=\"0.1\"/>".repeat(count);
        let body = format!("<body pos=\"0 0 1\"><freejoint/>{spheres}</body>");
        let mjcf = document(&body.repeat(2), "");
        assert_eq!(World::new(Arc::new(robot(&mjcf).unwrap())).step(&[]), succeeds, "{count}");
    }
}
