//! Tests of models that cannot be built: the error names the element and its line.

use super::{LOPSIDED, document, robot, robot_of_files};

fn bodies(body: &str) -> String {
    document(&format!("<body name=\"b\">{body}</body>"), "")
}

fn geom(attributes: &str) -> String {
    bodies(&format!("<joint name=\"j\"/>\n<geom {attributes}/>"))
}

fn actuator(actuator: &str) -> String {
    document(LOPSIDED, &format!("\n{actuator}"))
}

fn section(text: &str) -> String {
    document(LOPSIDED, "").replace("</mujoco>", &format!("{text}</mujoco>"))
}

fn assert_refused(cases: &[(String, &str)]) {
    for (mjcf, expected) in cases {
        let Err(reason) = robot(mjcf) else { panic!("built instead of: {expected}") };
        assert!(reason.contains(expected), "{reason}\ninstead of: {expected}");
        assert!(!reason.contains('\n'), "{reason}");
    }
}

#[test]
fn refused_bodies_joints_and_shapes_are_named_with_their_lines() {
    assert_refused(&[
        (geom("size=\"0.1\" shiny=\"1\""), "line 4, <geom>: the attribute `shiny`"),
        (geom("size=\"0.1\" class=\"\""), "line 4, <geom class=\"\">: no default has the class ``"),
        (geom("type=\"hfield\""), "line 4, <geom>: a height field must be fixed to the world"),
        (
            geom("type=\"sdf\" size=\".1 .2 .3\""),
            "line 4, <geom>: the type `sdf` is not supported; use a box or a mesh",
        ),
        (
            geom("type=\"mesh\" mesh=\"lost\""),
            "line 4, <geom>: no mesh has the name `lost`; there is none",
        ),
        (
            geom("size=\"1e-50\""),
            "line 4, <geom>: `size` must lie in 0..=10000 m and be 0 or at least 1e-6",
        ),
        (geom("size=\"1e39\""), "line 4, <geom>: `size` must lie in 0..=10000 m, is 1e39"),
        (
            geom("type=\"box\" size=\"1 0 1\""),
            "line 4, <geom>: `size` must have 3 positive numbers",
        ),
        (
            geom("size=\"0.1\" solref=\"0.02 -1\""),
            "line 4, <geom>: the two numbers of its `solref`",
        ),
        (
            geom("size=\"0.1\" class=\"lost\""),
            "line 4, <geom class=\"lost\">: no default has the class",
        ),
        (geom("size=\"x\""), "line 4, <geom>: size=\"x\" must be finite numbers"),
        (
            bodies("\n<joint name=\"j\" type=\"ball\" range=\"0.1 1\"/><geom size=\"1\"/>"),
            "line 4, <joint name=\"j\">: the `range` of a ball joint must start at 0",
        ),
        (
            bodies("\n<joint name=\"j\" springdamper=\"1 0\"/><geom size=\"1\"/>"),
            "line 4, <joint name=\"j\">: `springdamper` must be a positive time constant",
        ),
        (bodies("<joint/>"), "line 3, <body name=\"b\">: a body that moves must have a mass"),
        (bodies("<composite/>"), "line 3, <composite>: this element is not supported"),
        (bodies("<geom size=\"0.1\"/>"), "the model has no joints"),
        (bodies("<geom size=\"1\"><plugin/></geom>"), "line 3, <plugin>: this element"),
        (bodies("geom size=\"1\"/>"), "line 3, <body name=\"b\">: text between elements"),
        (bodies("<geom xml:size=\"2\" size=\"1\"/>"), "line 3, <geom>: names with a prefix"),
        (
            bodies("<inertial pos=\"0 0 0\" mass=\"1\"/>\n<inertial pos=\"0 0 0\" mass=\"2\"/>"),
            "line 4, <inertial>: its body has another",
        ),
        (bodies("<joint/><inertial mass=\"1\"/>"), "<inertial>: it must have `pos` and `mass`"),
        (
            bodies("<joint limited=\"True\" range=\"-1 1\"/><geom size=\"1\"/>"),
            "line 3, <joint>: limited=\"True\" must be true or false",
        ),
        (geom("size=\"0.1\" condim=\"2\""), "line 4, <geom>: `condim` must be 1, 3, 4 or 6"),
        (geom("size=\"1e5\""), "line 4, <geom>: `size` must lie in 0..=10000 m, is 100000"),
        (geom("type=\"box\" size=\"1 1 1 1\""), "line 4, <geom>: `size` must have at most 3"),
    ]);
}

#[test]
fn a_model_that_is_nested_too_deeply_is_refused_before_the_stack_overflows() {
    let starts = [
        "<body>",
        "<body name=\"/>\">",
        "<body name='/>'>",
        "<body><!--</body>-->",
        "<body><![CDATA[</body>]]>",
        "<body><?p </body>?>",
        "<body><site name=\"</body>\"/>",
    ];
    for start in starts {
        let nested = format!("{}{}", start.repeat(10_000), "</body>".repeat(10_000));
        assert_refused(&[(
            section(&nested),
            "line 5: elements are nested more than 200 deep; nest fewer",
        )]);
    }
}

#[test]
fn bombs_cycles_and_links_out_of_the_folder_are_refused_before_they_grow() {
    // Each of three levels includes the next a hundred times; each of eight entities is ten times the one before.
    let read = |path: &str| match path.strip_prefix("level") {
        Some(level) => {
            let level: u32 = level.parse().unwrap();
            let count = if level < 3 { 100 } else { 0 };
            let include = format!("<include file=\"level{}\"/>", level + 1).repeat(count);
            Ok(format!("<mujoco>{include}</mujoco>").into_bytes())
        }
        None => {
            let next = if path == "self.xml" { path } else { &format!("{path}a") };
            Ok(format!("<mujoco>\n<include file=\"{next}\"/></mujoco>").into_bytes())
        }
    };
    let entities: String = (1..9)
        .map(|level| format!("<!ENTITY e{level} \"{}\">", format!("&e{};", level - 1).repeat(10)))
        .collect();
    let bomb = format!("<!DOCTYPE m [<!ENTITY e0 \"x\">{entities}]><mujoco model=\"&e8;\"/>");
    let include = |file: &str| section(&format!("\n<include file=\"{file}\"/>"));
    for (mjcf, expected) in [
        (
            bodies(&format!(
                "<replicate count=\"1000\"><geom size=\"1\" user=\"{}\"/></replicate>",
                "0 ".repeat(500_000)
            )),
            "<replicate>: the copies of `replicate` have more than 4194304 bytes; make fewer",
        ),
        (bomb, "line 1: a DTD is not supported; remove it"),
        ("<mujoco>\n<worldbody>\n".to_owned(), "it ends in line 2, before all elements do"),
        (
            include("self.xml"),
            "self.xml line 2, <include file=\"self.xml\">: self.xml includes itself; remove one",
        ),
        (
            include("a"),
            "aaaaaaaa line 2, <include file=\"aaaaaaaaa\">: files are included more than 8",
        ),
        (include("level0"), "the model names more than 1000 files"),
        (include("../robot.xml"), "`../robot.xml` leaves the model's folder"),
        (include("/etc/robot.xml"), "`/etc/robot.xml` is an absolute path"),
        (
            section(
                "\n<asset><mesh name=\"m\" file=\"../m.stl\"/></asset><worldbody><geom type=\"box\" mesh=\"m\"/></worldbody>",
            ),
            "<mesh name=\"m\">: `../m.stl` leaves the model's folder",
        ),
    ] {
        let reason = robot_of_files(&mjcf, &read).err().unwrap();
        assert!(reason.contains(expected) && !reason.contains('\n'), "{reason}");
    }
}

#[test]
fn attributes_of_a_default_are_refused_before_every_element_copies_them() {
    let name = "m".repeat(5000);
    let mjcf = document(LOPSIDED, "")
        .replace("<mujoco>", &format!("<mujoco><default><geom mesh=\"{name}\"/></default>"));
    let reason = "<geom>: its attributes have more than 4096 bytes; shorten them";
    assert_refused(&[(mjcf, reason)]);
}

#[test]
fn long_names_are_cut_in_messages_and_not_compared_letter_by_letter() {
    let name = "n".repeat(60_000);
    let known = format!("<body><joint name=\"{name}x\"/><geom size=\"1\"/></body>");
    let mjcf = document(&known, &format!("<motor joint=\"{name}\" ctrlrange=\"-1 1\"/>"));
    let reason = robot(&mjcf).err().unwrap();
    assert!(reason.contains("no hinge, slide or ball joint") && reason.len() < 100_000, "{reason}");
    let sizes = bodies(&format!("<joint/><geom size=\"{}x\"/>", "1 ".repeat(60_000)));
    let reason = robot(&sizes).err().unwrap();
    assert!(reason.contains("must be finite numbers") && reason.len() < 200, "{reason}");
}

#[test]
fn more_height_fields_than_a_world_may_have_are_refused_before_their_memory_is_taken() {
    let grounds = "<geom type=\"hfield\" hfield=\"h\"/>\n".repeat(9);
    let asset =
        "<mujoco><asset><hfield name=\"h\" nrow=\"2\" ncol=\"2\" size=\"1 1 1 1\"/></asset>";
    let mjcf = document(&format!("{grounds}{LOPSIDED}"), "").replace("<mujoco>", asset);
    assert_refused(&[(mjcf, "<geom>: a world may have 8 height fields; remove others")]);
}

#[test]
fn refused_actuators_are_named_with_their_lines() {
    assert_refused(&[
        (
            actuator("<motor joint=\"lost\" ctrlrange=\"-1 1\"/>"),
            "line 6, <motor joint=\"lost\">: no hinge, slide or ball joint",
        ),
        (
            actuator("<motor joint=\"j\"/>"),
            "line 6, <motor joint=\"j\">: its control must be limited",
        ),
        (
            actuator("<motor tendon=\"t\" ctrlrange=\"-1 1\"/>"),
            "line 6, <motor>: no fixed tendon has the name `t`; there is none",
        ),
        (
            actuator("<motor joint=\"root\" ctrlrange=\"-1 1\"/>"),
            "line 6, <motor joint=\"root\">: `root` is a free joint, which no actuator moves here",
        ),
        (actuator("<replicate count=\"2\"/>"), "line 6, <replicate>: this actuator"),
        (actuator("<muscle joint=\"j\"/>"), "line 6, <muscle joint=\"j\">: this actuator"),
        (
            actuator("<general joint=\"j\" dyntype=\"muscle\" ctrlrange=\"0 1\"/>"),
            "line 6, <general joint=\"j\">: dyntype=\"muscle\" is not supported; set one of none, integrator",
        ),
        (
            actuator("<general joint=\"j\" dyntype=\"filter\" dynprm=\"0\" ctrlrange=\"0 1\"/>"),
            "line 6, <general joint=\"j\">: the time constant at the start of `dynprm` must not be 0",
        ),
        (
            actuator("<position joint=\"j\" dampratio=\"1\" kv=\"1\" ctrlrange=\"0 1\"/>"),
            "line 6, <position joint=\"j\">: `dampratio` must not be stated with `kv`",
        ),
    ]);
}

#[test]
fn a_mocap_body_that_moves_is_refused() {
    let body = |of| bodies(&format!("<joint/><geom size=\"1\"/><body mocap=\"true\">{of}</body>"));
    let reason = "a mocap body is in the `worldbody` itself and has no joint; remove `mocap`";
    assert_refused(&[(body(""), reason), (body("<joint/><geom size=\"1\"/>"), reason)]);
}

/// MuJoCo 4.0.0 refuses all of them, too.
#[test]
fn what_mujoco_does_not_compile_is_refused() {
    let joints = |joints: &str| bodies(&format!("{joints}<geom size=\"1\"/>"));
    let inertia =
        |moments: &str| bodies(&format!("<joint/><inertial pos=\"0 0 0\" mass=\"1\" {moments}/>"));
    let (ball, hinge, slide) = ("<joint type=\"ball\"/>", "<joint/>", "<joint type=\"slide\"/>");
    let free = "<body pos=\"0 0 9\"><freejoint/><geom size=\"1\"/></body>";
    let exceeds = "none may exceed the sum of the others";
    assert_refused(&[
        (inertia("diaginertia=\"1 1 5\""), exceeds),
        (inertia("diaginertia=\"1 1 2.000001\""), exceeds),
        (inertia("fullinertia=\"1 1 5 0.1 0 0\""), exceeds),
        (joints(&format!("{ball}{hinge}")), "no hinge or ball may follow a ball joint"),
        (joints(&format!("{ball}{slide}{ball}")), "no hinge or ball may follow a ball joint"),
        (joints(&hinge.repeat(7)), "its joints have 7 degrees of freedom, at most 6"),
        (
            bodies(&format!("{free}<geom size=\"1\"/>")),
            "must be the only joint of a child of the world",
        ),
        (joints(&format!("{hinge}{free}")), "must be the only joint of a child of the world"),
        (geom("size=\"1\" contype=\"2147483648\""), "must be a whole number of 32 bits"),
        (geom("size=\"1\" conaffinity=\"-2147483649\""), "must be a whole number of 32 bits"),
        (
            actuator("<motor joint=\"j\" gainprm=\"7\"/>"),
            "the attribute `gainprm` is not supported",
        ),
        (actuator("<motor joint=\"j\" kp=\"5\"/>"), "the attribute `kp` is not supported"),
        (actuator("<position joint=\"j\" dyntype=\"filter\"/>"), "the attribute `dyntype` is not"),
        (actuator("<general joint=\"j\" kv=\"1\"/>"), "the attribute `kv` is not supported"),
        (actuator("<general joint=\"j\" actrange=\"-1 1\"/>"), "an `actrange` needs an activation"),
        (actuator("<position joint=\"j\" kv=\"-1\"/>"), "`kv` must not be negative"),
        (
            actuator("<position joint=\"j\" inheritrange=\"1\" ctrlrange=\"-1 1\"/>"),
            "`inheritrange` must not be stated with `ctrlrange`",
        ),
        (
            actuator("<intvelocity joint=\"j\" inheritrange=\"1\" actrange=\"-1 1\"/>"),
            "`inheritrange` must not be stated with `actrange`",
        ),
        (
            actuator("<intvelocity joint=\"j\" inheritrange=\"1\" ctrlrange=\"-1 1\"/>"),
            "its joint or tendon has no range to inherit",
        ),
        (
            section("<asset><model name=\"m\" file=\"lost.xml\"/></asset>"),
            "lost.xml does not exist",
        ),
        (
            section(&format!("<asset>{0}{0}</asset>", "<hfield name=\"h\" size=\"1 1 1 1\"/>")),
            "<hfield name=\"h\">: another one has the same name; rename one",
        ),
        (
            section(&format!("<equality>{0}{0}</equality>", "<joint name=\"e\" joint1=\"j\"/>")),
            "another element has the name `e`, too",
        ),
        (
            section("<compiler autolimits=\"false\"/>")
                .replace("axis=\"1 1 0\"", "axis=\"1 1 0\" range=\"-1 1\""),
            "without `autolimits`, `limited` must be true or false; set it",
        ),
    ]);
}

#[test]
fn refused_sections_are_named_with_their_lines() {
    assert_refused(&[
        (
            section("<equality>\n<flex body1=\"b\"/></equality>"),
            "line 6, <flex>: only equalities of joints, of fixed tendons, `connect` and `weld`",
        ),
        (
            section("\n<tendon><spatial name=\"t\" stiffness=\"1\"/></tendon>"),
            "line 6, <spatial name=\"t\">: a spatial tendon with forces",
        ),
        (
            section("\n<tendon><fixed name=\"t\"><joint joint=\"lost\"/></fixed></tendon>"),
            "line 6, <joint joint=\"lost\">: no hinge or slide has the name `lost`",
        ),
        (
            section("\n<equality><joint joint1=\"j\" joint2=\"k\"/></equality>"),
            "line 6, <joint>: no hinge or slide has the name `k`; there are j",
        ),
        (
            section("\n<equality><connect site1=\"a\" site2=\"b\"/></equality>"),
            "line 6, <connect>: no site has the name `a`; there is none",
        ),
        (
            section("\n<contact><pair geom1=\"a\"/></contact>"),
            "line 6, <pair>: no shape that can touch has the name `a`",
        ),
        (section("\n<option><falg gravity=\"disable\"/></option>"), "line 6, <falg>: this element"),
        (section("\n<default><goem size=\"1\"/></default>"), "line 6, <goem>: this element"),
        (section("\n<default clas=\"a\"/>"), "line 6, <default>: the attribute `clas`"),
        (
            section("<default><default class=\"a\"/><default class=\"a\"/></default>"),
            "two defaults have the class `a`",
        ),
        (section("\n<deformable/>"), "line 6, <deformable>: this element"),
        (
            section("\n<option viscosity=\"-0.1\"/>"),
            "line 6, <option>: `viscosity` must lie in 0..=",
        ),
        (
            section("\n<option density=\"nan\"/>"),
            "line 6, <option>: density=\"nan\" must be finite",
        ),
        (
            section("\n<asset><mesh file=\"/a.stl\"/></asset><include file=\"../b.xml\"/>"),
            "line 6, <include file=\"../b.xml\">: `../b.xml` leaves",
        ),
    ]);
}

#[test]
fn refused_height_fields_and_pairs_are_named_with_what_to_do() {
    let field = |attributes: &str| {
        let ground = "<geom type=\"hfield\" hfield=\"h\"/>";
        let asset = format!("<mujoco><asset><hfield name=\"h\" {attributes}/></asset>");
        document(&format!("{ground}{LOPSIDED}"), "").replace("<mujoco>", &asset)
    };
    let pair = |attributes: &str| {
        let shapes = "<geom name=\"wall\" type=\"box\" size=\"1 1 1\"/>\
            <body pos=\"0 0 9\"><joint/><geom name=\"a\" size=\"0.1\"/></body>";
        let pair = format!("<contact><pair geom1=\"a\" {attributes}/></contact></mujoco>");
        document(shapes, "").replace("</mujoco>", &pair)
    };
    assert_refused(&[
        (field("file=\"a.png\""), "<hfield name=\"h\">: a.png does not exist"),
        (field("file=\"../a.png\""), "<hfield name=\"h\">: `../a.png` leaves the model's folder"),
        (field("nrow=\"1\" ncol=\"2\""), "`nrow` must lie in 2..=1048576, is 1"),
        (field("nrow=\"99999\" ncol=\"99999\" size=\"1 1 1 1\""), "at most 1048576 heights"),
        (field("nrow=\"2\" ncol=\"2\" size=\"1 1 0 1\""), "`size` must be positive"),
        (
            field("nrow=\"2\" ncol=\"2\" size=\"1 1 1 1\" elevation=\"1 2 3\""),
            "`elevation` must have 4 numbers, has 3",
        ),
        (pair(""), "it must have `geom2`; add it"),
        (pair("geom2=\"lost\""), "no shape that can touch has the name `lost`"),
        (pair("geom2=\"wall\" condim=\"2\""), "`condim` must be 1, 3, 4 or 6"),
        (pair("geom2=\"wall\" solref=\"0.02 -1\""), "the two numbers of its `solref`"),
        (
            pair("geom2=\"wall\" solreffriction=\"1 -1\""),
            "the two numbers of its `solreffriction` must both be positive",
        ),
    ]);
}

#[test]
fn refused_tendons_are_named_with_what_to_do() {
    assert_refused(&[
        (
            section("<tendon><fixed><joint joint=\"j\"/>\n<joint joint=\"j\"/></fixed></tendon>"),
            "line 6, <joint joint=\"j\">: its tendon has this joint twice",
        ),
        (
            section("<tendon><fixed springlength=\"2 1\"><joint joint=\"j\"/></fixed></tendon>"),
            "<fixed>: `springlength` must be one length, or two that ascend",
        ),
        (
            section("<tendon><fixed range=\"-1 5 1\"><joint joint=\"j\"/></fixed></tendon>"),
            "`range` must have 2 numbers, it has 3",
        ),
    ]);
}
