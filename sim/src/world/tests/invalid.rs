//! Tests of elements that MuJoCo 4.0.0 refuses: here they are refused, too, even where they would have no effect.

use super::{document, robot};

/// Asserts that a world with these bodies and sections before it is refused with one line.
fn assert_refused(sections: &str, bodies: &str, expected: &str) {
    let mjcf = document(bodies, "").replace("<worldbody>", &format!("{sections}<worldbody>"));
    let Err(reason) = robot(&mjcf) else { panic!("built instead of: {expected}") };
    assert!(reason.contains(expected), "{reason}\ninstead of: {expected}");
    assert!(!reason.contains('\n'), "{reason}");
}

#[test]
fn two_points_of_a_shape_are_refused_where_they_do_not_decide_its_place() {
    let assets = "<asset><mesh name=\"m\" vertex=\"0 0 0 1 0 0 0 1 0 0 0 1\"/>\
        <hfield name=\"h\" nrow=\"2\" ncol=\"2\" size=\"1 1 1 1\"/></asset>";
    let place = "<default><geom pos=\"0 0 1\"/></default>";
    for (sections, attributes, expected) in [
        (
            "",
            "type=\"capsule\" size=\".1\" pos=\"0 0 1\"",
            "has both `pos` and `fromto`; remove one",
        ),
        (place, "type=\"box\" size=\".1\"", "has both `pos` and `fromto`; remove one"),
        ("", "size=\".1\"", "a shape of the type `sphere` has no `fromto`; remove it"),
        (assets, "type=\"mesh\" mesh=\"m\"", "of the type `mesh` has no `fromto`; remove it"),
        (assets, "type=\"hfield\" hfield=\"h\"", "of the type `hfield` has no `fromto`; remove it"),
        (assets, "type=\"capsule\" mesh=\"m\"", "a shape with a `mesh` has no `fromto`; remove it"),
    ] {
        let shape = format!("<geom fromto=\"0 0 0 1 0 0\" {attributes}/>");
        let moving = "<body pos=\"0 0 9\"><joint/><geom size=\"1\"/></body>";
        assert_refused(sections, &format!("{shape}{moving}"), expected);
    }
    // MuJoCo ignores what has no effect.
    let level = "<body><joint/><geom type=\"capsule\" size=\".1\" pos=\"0 0 0\" zaxis=\"1 0 0\" \
        fromto=\"0 0 0 1 0 0\"/></body>";
    assert!(robot(&document(level, "")).is_ok());
}

#[test]
fn the_type_and_size_of_a_shape_that_nothing_can_touch_are_checked() {
    for (attributes, expected) in [
        ("type=\"foo\" size=\"1\"", "line 3, <geom>: the type `foo` is not supported"),
        ("size=\"-1\"", "line 3, <geom>: `size` must have 1 positive numbers"),
        ("", "line 3, <geom>: `size` must have 1 positive numbers"),
        ("type=\"box\" size=\"1 1\"", "line 3, <geom>: `size` must have 3 positive numbers"),
        ("type=\"foo\" mesh=\"m\"", "line 3, <geom>: the type `foo` is not supported"),
        ("type=\"plane\" size=\"1 1\"", "line 3, <geom>: a plane's `size` must have three numbers"),
        (
            "type=\"capsule\" size=\"1\" fromto=\"0 0 0 0 0 0\"",
            "line 3, <geom>: `fromto` names the same point twice",
        ),
    ] {
        let shape = format!("<geom contype=\"0\" conaffinity=\"0\" mass=\"0\" {attributes}/>");
        let moving = "<body pos=\"0 0 9\"><joint/><geom size=\"1\"/></body>";
        assert_refused("", &format!("{shape}{moving}"), expected);
        let inside = moving.replace("</body>", &format!("{shape}</body>"));
        assert_refused("", &inside, expected);
    }
    // Skies and thin plates, and numbers that have no effect.
    for attributes in ["size=\"50000\"", "type=\"box\" size=\"1 1 1e-7\"", "size=\".1 -1\""] {
        let shape = format!("<geom contype=\"0\" conaffinity=\"0\" mass=\"0\" {attributes}/>");
        let moving = "<body pos=\"0 0 9\"><joint/><geom size=\"1\"/></body>";
        assert!(robot(&document(&format!("{shape}{moving}"), "")).is_ok(), "{attributes}");
    }
}

#[test]
fn a_joint_in_a_replicate_is_in_a_body_there() {
    let expected = "a <replicate> has no joint outside a <body> in it; move it out, or into a body";
    for inside in ["<joint/>", "<freejoint/>", "<frame><joint/></frame>"] {
        let body =
            format!("<body><replicate count=\"2\">{inside}</replicate><geom size=\"1\"/></body>");
        assert_refused("", &body, expected);
    }
}

#[test]
fn the_main_class_has_no_other_name_and_the_world_no_attributes() {
    let body = "<body><joint/><geom class=\"zz\" size=\"1\"/></body>";
    let renamed = "<default class=\"zz\"><geom condim=\"1\"/></default>";
    let expected = "<default class=\"zz\">: an outermost default has the class `main`; remove its";
    assert_refused(renamed, body, expected);
    let mjcf = document("<body><joint/><geom size=\"1\"/></body>", "");
    for attribute in ["childclass=\"main\"", "pos=\"0 0 0\"", "name=\"world\""] {
        let world = mjcf.replace("<worldbody>", &format!("<worldbody {attribute}>"));
        let reason = robot(&world).err().unwrap();
        let name = attribute.split('=').next().unwrap();
        let expected = format!("the attribute `{name}` is not supported; remove it");
        assert!(reason.contains(&expected) && !reason.contains('\n'), "{reason}");
    }
}

#[test]
fn a_misplaced_element_is_told_its_place_and_a_misspelt_one_its_spelling() {
    for (elements, expected) in [
        ("<joint/>", "<joint>: this element belongs in a <body>; move it there"),
        ("<motor joint=\"hip\"/>", "this element belongs in <actuator>; move it there"),
        ("<goem size=\"1\"/>", "<goem>: this element is unknown; did you mean `geom`?"),
        ("<flexcomp/>", "<flexcomp>: this element is not supported; remove it"),
        ("<geom size=\"1\"><material/></geom>", "<material>: this element belongs in <asset>;"),
    ] {
        assert_refused("", &format!("{elements}<body><joint/><geom size=\"1\"/></body>"), expected);
    }
    let body = "<body><joint name=\"hip\"/><geom size=\"1\"/></body>";
    let sections = document(body, "").replace("</worldbody>", "</worldbody><actuatr/>");
    let reason = robot(&sections).err().unwrap();
    assert!(reason.contains("this element is unknown; did you mean `actuator`?"), "{reason}");
}
