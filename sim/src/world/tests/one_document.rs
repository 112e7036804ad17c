//! Tests of models that are written as one document: the robot is that of the model's files.

use std::collections::{BTreeMap, BTreeSet};

use rapier3d::math::Vector;

use super::{robot, robot_of_files, trough};
use crate::robot::{Blueprint, LinkPlan, Robot, ShapePlan, one_document};
use crate::scene::Shape;

/// Two legs on a trunk. Files in two folders, classes that scale and hide meshes, and masses from meshes.
const WALKER: &str = r#"<mujoco>
  <compiler angle="radian" meshdir="meshes"/>
  <include file="parts/classes.xml"/>
  <asset><include file="parts/assets.xml"/><texture name="t" builtin="flat"/><material name="m" texture="t"/></asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="plane" size="1 1 1" material="m"/>
    <geom class="seen" mesh="wedge"/>
    <body name="trunk" pos="0 0 1">
      <freejoint name="root"/>
      <geom type="mesh" mesh="wedge" pos="0.1 0 0" euler="0.1 0.2 0.3"/>
      <geom class="seen" mesh="trough" mass="0.4"/>
      <geom type="box" size="0.1 0.2 0.3"/>
      <frame pos="0 0.1 0" euler="0 0 0.5"><geom class="seen" mesh="trough" pos="0 0 0.1"/></frame>
      <body name="leg" pos="0.2 0 -0.1" childclass="light">
        <joint name="hip" axis="0 1 1" range="-1 1"/>
        <geom type="mesh" mesh="scaled"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0.1 0 0.2"/>
        <site name="s &amp; &quot;t&quot;"/>
        <body name="foot" pos="0 0 -0.2">
          <geom class="seen" mesh="wedge" pos="0.01 0.02 0.03" quat="1 0.2 0 0"/>
          <geom name="a &lt; &quot;b&quot;" size="0.02"/>
        </body>
      </body>
      <body name="arm" pos="-0.2 0 0.1">
        <inertial pos="0 0 0.1" mass="0.3" diaginertia="0.001 0.002 0.0015"/>
        <joint name="shoulder" axis="0 0 1"/>
        <geom class="seen" mesh="lost"/>
        <geom type="mesh" mesh="wedge" contype="0"/>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="both"><joint joint="hip" coef="2"/><joint joint="shoulder"/></fixed></tendon>
  <equality><joint joint1="hip" joint2="shoulder" polycoef="0 0.5"/><weld body1="leg" active="false"/></equality>
  <actuator><motor joint="hip" ctrlrange="-1 1"/><motor tendon="both" ctrlrange="-1 1"/></actuator>
</mujoco>"#;
const CLASSES: &str = r#"<mujoco><default>
  <mesh scale="0.05 0.05 0.05"/>
  <default class="seen"><geom type="mesh" contype="0" conaffinity="0" material="m"/></default>
  <default class="light"><geom density="200"/><mesh scale="0.1 -0.02 0.03" inertia="exact"/></default>
</default></mujoco>"#;
const ASSETS: &str = r#"<mujoco>
  <mesh file="trough.obj"/><mesh name="lost" file="lost.stl"/><mesh file="wedge.obj" inertia="convex"/>
  <mesh name="scaled" class="light" file="sub/trough.obj"/><mesh name="unused" file="lost.stl"/>
</mujoco>"#;
const WEDGE: &str = "v 0 0 0\nv 2 0 0\nv 0 1 0\nv 0 0 3\nv 0.3 0.2 0.5\nv 0.1 0.1 0.1\n\
    f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";

fn files(document: &str) -> BTreeMap<&'static str, String> {
    BTreeMap::from([
        ("robot.xml", document.to_owned()),
        ("parts/classes.xml", CLASSES.to_owned()),
        ("parts/assets.xml", ASSETS.to_owned()),
        ("meshes/trough.obj", trough()),
        ("meshes/sub/trough.obj", trough()),
        ("meshes/wedge.obj", WEDGE.to_owned()),
        // Two rows of two heights: 0, 2, 0.5 and 0 m.
        ("meshes/hills.bin", "\u{2}\0\0\0\u{2}\0\0\0\0\0\0\0\0\0\0@\0\0\0?\0\0\0\0".to_owned()),
    ])
}

/// Reads a file of `files`.
fn read(files: &BTreeMap<&'static str, String>, path: &str) -> Result<Vec<u8>, String> {
    let text = files.get(path).ok_or_else(|| format!("{path} does not exist"))?;
    Ok(text.as_bytes().to_vec())
}

/// The robot of the files, that of the one document, and the document.
fn both(document: &str) -> (Robot, Robot, String) {
    let files = files(document);
    let direct = robot_of_files(document, &|path| read(&files, path)).unwrap();
    let text = one_document("robot.xml", |path| read(&files, path)).unwrap();
    let flat = robot(&text).unwrap();
    (direct, flat, text)
}

fn assert_near(what: &str, got: &[f32], expected: &[f32]) {
    let size = expected.iter().fold(1e-6, |most: f32, x| most.max(x.abs()));
    let off = got.iter().zip(expected).fold(0.0, |most: f32, (a, b)| most.max((a - b).abs()));
    assert!(off <= 2e-6 * size, "{what}: {got:?} against {expected:?}");
}

fn assert_same_shape(name: &str, got: &ShapePlan, expected: &ShapePlan) {
    let place = |plan: &ShapePlan| format!("{:?} {:?} {}", plan.pose, plan.surface, plan.body);
    assert_eq!(place(got), place(expected), "{name}");
    let corners = |shape: &Shape| match shape {
        Shape::Hull(hull) => hull.points.iter().map(|point| point.map(f32::to_bits)).collect(),
        _ => BTreeSet::new(),
    };
    assert_eq!(corners(&got.shape), corners(&expected.shape), "{name}");
    if !matches!(expected.shape, Shape::Hull(_)) {
        assert_eq!(got.shape, expected.shape, "{name}");
    }
}

fn assert_same_link(got: &LinkPlan, expected: &LinkPlan) {
    let name = expected.name.as_str();
    let frame = |link: &LinkPlan| {
        format!("{} {:?} {:?} {:?}", link.name, link.parent, link.rest, link.joint)
    };
    assert_eq!(frame(got), frame(expected));
    let [mass, other] = [got, expected].map(|link| link.mass);
    assert_near(name, &[mass.mass()], &[other.mass()]);
    assert_near(name, &mass.local_com.to_array(), &other.local_com.to_array());
    // The whole inertia, since the axes of equal moments are arbitrary.
    let [got_inertia, inertia] = [mass, other].map(|mass| mass.reconstruct_inertia_matrix());
    assert_near(name, &got_inertia.to_cols_array(), &inertia.to_cols_array());
    assert_eq!(got.shapes.len(), expected.shapes.len(), "{name}");
    got.shapes.iter().zip(&expected.shapes).for_each(|(a, b)| assert_same_shape(name, a, b));
}

fn assert_same(document: &str) -> String {
    let (direct, flat, text) = both(document);
    let [expected, got] = [&direct.blueprint, &flat.blueprint];
    let rest = |plan: &Blueprint| {
        let Blueprint {
            timestep_secs,
            gravity,
            integration,
            grounds,
            motors,
            bodies,
            left_out,
            tendons,
            equalities,
            ..
        } = plan;
        format!(
            "{timestep_secs} {gravity} {integration:?} {grounds:?} {motors:?} {bodies:?} {left_out:?} \
             {tendons:?} {equalities:?}"
        )
    };
    assert_eq!(rest(got), rest(expected));
    assert_eq!(got.links.len(), expected.links.len());
    got.links.iter().zip(&expected.links).for_each(|(a, b)| assert_same_link(a, b));
    assert!(!text.contains("file="), "{text}");
    text
}

#[test]
fn a_model_written_as_one_document_has_the_masses_and_shapes_of_its_files() {
    let text = assert_same(WALKER);
    // The wedge has four corners in its hull and two inside. What only decorates is gone.
    assert_eq!(text.matches("<mesh ").count(), 2, "{text}");
    assert_eq!(text.matches("<inertial ").count(), 4, "{text}");
    assert!(!text.contains("trough\"") && !text.contains("material"), "{text}");
    assert!(!text.contains("<site"), "{text}");
}

#[test]
fn only_sites_that_a_connection_names_remain_in_one_document() {
    let connect = "<equality><connect site1=\"a\" site2=\"b\" active=\"false\"/>";
    let sites = "<site name=\"a\"/><site name=\"b\" material=\"m\"/><site name=\"imu\"/><site/>";
    let document = WALKER
        .replace("<equality>", connect)
        .replace("<body name=\"foot\"", &format!("{sites}<body name=\"foot\""));
    let text = assert_same(&document);
    assert!(text.contains("<site name=\"a\"/>") && text.contains("<site name=\"b\"/>"), "{text}");
    assert_eq!(text.matches("<site").count(), 2, "{text}");
}

#[test]
fn fitted_shapes_and_height_fields_of_files_are_stated() {
    let fitted = "<frame pos=\"0 0.1 0\" euler=\"0 0.3 0\"><geom type=\"capsule\" mesh=\"trough\" \
        fitscale=\"0.5\" euler=\"0.1 0 0\" pos=\"0 0 0.2\"/></frame>";
    let document = WALKER
        .replace("<geom type=\"box\" size=\"0.1 0.2 0.3\"/>", fitted)
        .replace("<texture name", "<hfield file=\"hills.bin\" size=\"2 1 0.5 1\"/><texture name")
        .replace("<light pos", "<geom type=\"hfield\" hfield=\"hills\"/><light pos");
    let (direct, flat, text) = both(&document);
    assert!(!text.contains("file="), "{text}");
    let [expected, got] = [&direct, &flat].map(|robot| {
        let grounds = format!("{:?}", robot.blueprint.grounds);
        let capsule = |shape: &&ShapePlan| matches!(shape.shape, Shape::Capsule { .. });
        (grounds, robot.blueprint.shapes().find(capsule).unwrap())
    });
    assert!(expected.0.contains("heights: [0.125, 0.0, 0.0, 0.5]"), "{}", expected.0);
    assert_eq!(got.0, expected.0);
    assert_eq!(got.1.shape, expected.1.shape);
    let corner = |plan: &ShapePlan| (plan.pose * Vector::new(0.1, 0.2, 0.3)).to_array();
    assert_near("a fitted capsule", &corner(got.1), &corner(expected.1));
}

#[test]
fn shapes_whose_class_names_their_mesh_remain_in_one_document() {
    let classes = "<default><default class=\"fitted\"><geom type=\"capsule\" mesh=\"trough\" fitscale=\"0.5\"/>\
        <default class=\"whole\"><geom type=\"mesh\" mesh=\"wedge\"/></default></default></default><asset>";
    let shapes =
        "<geom class=\"fitted\" pos=\"0 0 0.2\"/><geom class=\"whole\" pos=\"0.1 0 0.2\"/>";
    let text = assert_same(
        &WALKER
            .replace("<asset>", classes)
            .replace("<geom type=\"box\" size=\"0.1 0.2 0.3\"/>", shapes),
    );
    assert!(!text.contains("trough"), "{text}");
}

#[test]
fn the_limit_of_the_corners_of_a_hull_is_reported_of_one_document() {
    let limited = "<asset><mesh name=\"limited\" file=\"sub/trough.obj\" maxhullvert=\"4\"/>";
    let document =
        WALKER.replace("<asset>", limited).replace("mesh=\"scaled\"", "mesh=\"limited\"");
    assert_same(&document);
    let (_, flat, _) = both(&document);
    let left_out = flat.left_out();
    assert!(left_out.iter().any(|what| what.contains("maxhullvert")), "{left_out:?}");
}

/// MuJoCo 4.0.0 reads meshes from these folders.
#[test]
fn the_last_folder_of_meshes_counts_and_of_one_element_that_of_meshes_alone() {
    for (compilers, expected) in [
        ("<compiler meshdir=\"a\"/><compiler meshdir=\"b\"/>", "b"),
        ("<compiler meshdir=\"a\"/><compiler assetdir=\"b\"/>", "b"),
        ("<compiler assetdir=\"a\"/><compiler meshdir=\"b\"/>", "b"),
        ("<compiler meshdir=\"b\" assetdir=\"a\"/><compiler angle=\"radian\"/>", "b"),
        ("<compiler meshdir=\"a\"/><compiler meshdir=\"\"/>", ""),
    ] {
        let mjcf = format!(
            "<mujoco>{compilers}<asset><mesh file=\"m.obj\"/></asset><worldbody><body><joint/>\
             <geom type=\"mesh\" mesh=\"m\"/></body></worldbody></mujoco>"
        );
        let path = [expected, "m.obj"].join("/");
        let source = |name: &str| {
            let is_it = name == path.trim_start_matches('/');
            if is_it {
                Ok(WEDGE.as_bytes().to_vec())
            } else {
                Err(format!("{name} is another file"))
            }
        };
        assert_eq!(robot_of_files(&mjcf, &source).err(), None, "{compilers}");
    }
}

#[test]
fn every_source_of_masses_survives() {
    for compiler in ["inertiafromgeom=\"true\"", "inertiafromgeom=\"auto\" settotalmass=\"7\""] {
        assert_same(
            &WALKER
                .replace("<compiler", &format!("<compiler {compiler}"))
                .replace("mesh=\"lost\"", "mesh=\"wedge\""),
        );
    }
    let inertial = "<inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"1 1 1\"/>";
    let stated = WALKER
        .replace("<compiler", "<compiler inertiafromgeom=\"false\"")
        .replace("<freejoint name=\"root\"/>", &format!("<freejoint name=\"root\"/>{inertial}"))
        .replace("<joint name=\"hip\"", &format!("{inertial}<joint name=\"hip\""));
    assert_same(&stated);
}

#[test]
fn the_frame_of_an_aligned_body_survives() {
    let mesh = "<geom type=\"mesh\" mesh=\"wedge\" pos=\"0.1 0.2 0.3\" euler=\"0.1 0.2 0.3\"/>";
    let shapes = "<geom type=\"mesh\" mesh=\"wedge\"/><geom size=\"0.3\" pos=\"1 2 3\"/>";
    for shapes in [mesh, shapes] {
        let body =
            format!("<body name=\"box\" pos=\"0 9 1\"><freejoint align=\"true\"/>{shapes}</body>");
        let (direct, flat, text) =
            both(&WALKER.replace("</worldbody>", &format!("{body}</worldbody>")));
        assert!(text.contains("diaginertia") && text.contains("align=\"true\""), "{text}");
        let numbers = |robot: &Robot| {
            let link = robot.blueprint.links.iter().find(|link| link.name == "box").unwrap();
            let poses = [&link.rest, &link.shapes[0].pose];
            let numbers = poses.map(|pose| {
                let [x, y, z, w] = pose.rotation.to_array();
                let [a, b, c] = pose.translation.to_array();
                [a, b, c, x, y, z, w]
            });
            [&numbers[0][..], &numbers[1], &link.mass.principal_inertia().to_array()].concat()
        };
        let [got, expected] = [&flat, &direct].map(numbers);
        let moved = direct.blueprint.links.iter().any(|link| link.rest.translation.y > 9.1);
        assert!(moved, "{expected:?}");
        for (got, expected) in got.iter().zip(&expected) {
            assert!((got - expected).abs() < 2e-5 * expected.abs().max(1.0), "{got} {expected}");
        }
    }
}

#[test]
fn a_base_of_decoration_remains_a_link() {
    let fixed = WALKER.replace("<freejoint name=\"root\"/>", "").replace(
        "<body name=\"trunk\"",
        "<body name=\"base\"><geom class=\"seen\" mesh=\"lost\" mass=\"0\"/></body><body name=\"trunk\"",
    );
    let text = assert_same(&fixed);
    assert!(text.contains("<mesh name=\"lost\" vertex=\"0 0 0 0.001"), "{text}");
}

#[test]
fn elements_of_included_files_count_where_they_are_included() {
    let nested = |inside: &str| {
        format!("<mujoco>{}{inside}{}</mujoco>", "<body>".repeat(120), "</body>".repeat(120))
    };
    let read = |path: &str| match path {
        "a.xml" => Ok(nested("<include file=\"b.xml\"/>").into_bytes()),
        "wide.xml" => {
            Ok(format!("<mujoco>{}</mujoco>", "<include file=\"c.xml\"/>".repeat(30)).into())
        }
        "c.xml" => Ok(format!("<mujoco>{}</mujoco>", "<body/>".repeat(1000)).into_bytes()),
        "large.xml" => Ok(vec![b' '; 5 << 20]),
        _ => Ok(nested("").into_bytes()),
    };
    for (document, expected) in [
        ("a.xml", "b.xml line 1, <body>: elements are nested more than 200 deep; nest fewer"),
        ("wide.xml", "c.xml line 1, <body>: the model has more than 20000 elements; remove some"),
        ("large.xml", "large.xml has 5242880 bytes, at most 4194304"),
    ] {
        let error = one_document(document, read).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn a_model_that_needs_no_other_file_is_returned_unchanged() {
    let document = "<mujoco>  <asset><mesh name=\"m\" file=\"lost.stl\"/></asset><worldbody><body>\
        <joint/><geom size=\"0.1\"/></body></worldbody></mujoco>";
    let read = |_: &str| Ok(document.as_bytes().to_vec());
    assert_eq!(one_document("a.xml", read).unwrap(), document);
}

#[test]
fn a_file_that_cannot_be_used_is_named_with_its_element() {
    for (from, to, expected) in [
        ("\"parts/classes.xml\"", "\"lost.xml\"", "line 3, <include file=\"lost.xml\">: lost.xml"),
        (
            "\"parts/classes.xml\"",
            "\"../a.xml\"",
            "line 3, <include file=\"../a.xml\">: `../a.xml` leaves",
        ),
        (
            "\"parts/classes.xml\"",
            "\"/etc/a.xml\"",
            "<include file=\"/etc/a.xml\">: `/etc/a.xml` is",
        ),
        (
            "meshdir=\"meshes\"",
            "meshdir=\"../m\"",
            "assets.xml line 2, <mesh file=\"wedge.obj\">: `../m/wedge.obj` leaves",
        ),
        ("meshdir=\"meshes\"", "meshdir=\"parts\"", "parts/wedge.obj does not exist"),
    ] {
        let files = files(&WALKER.replace(from, to));
        let error = one_document("robot.xml", |path| read(&files, path));
        let error = error.unwrap_err().to_string();
        assert!(error.contains(expected), "{error}\nnot {expected}");
    }
}
