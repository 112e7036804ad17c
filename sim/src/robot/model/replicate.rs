//! MuJoCo's `replicate`: copies of the elements in it, each in a frame and with names of its own.

use super::super::document::Element;
use super::super::folder::Folder;
use super::super::frame::{Angles, Frame, IDENTITY};
use super::options;

/// Attributes of `replicate`.
const KNOWN: [&str; 4] = ["count", "sep", "offset", "euler"];

/// Replaces each `replicate` in the world by its copies. MuJoCo has none in other sections.
pub(super) fn expand(root: &mut Element, folder: &mut Folder<'_>) -> Result<(), String> {
    // An error is noted where the settings are read.
    let angles = options::angles_of(root).unwrap_or_default();
    let mut worlds = root.children.iter_mut().filter(|section| section.tag == "worldbody");
    worlds.try_for_each(|world| expand_in(world, &angles, folder))
}

fn expand_in(
    element: &mut Element,
    angles: &Angles,
    folder: &mut Folder<'_>,
) -> Result<(), String> {
    for mut child in std::mem::take(&mut element.children) {
        expand_in(&mut child, angles, folder)?;
        if child.tag == "replicate" {
            element.children.extend(copies(&child, angles, folder)?);
        } else {
            element.children.push(child);
        }
    }
    Ok(())
}

/// The copies as frames, each moved in the frame of the one before.
fn copies(
    replicate: &Element,
    angles: &Angles,
    folder: &mut Folder<'_>,
) -> Result<Vec<Element>, String> {
    replicate.only(&[&KNOWN])?;
    let count = replicate.integer("count", 0)?;
    if count < 1 {
        return Err(replicate.refuse_for("count", "`count` must be at least 1"));
    }
    if let Some(joint) = joint_in(replicate) {
        let reason =
            "a <replicate> has no joint outside a <body> in it; move it out, or into a body";
        return Err(joint.refuse(reason));
    }
    let mut step = angles.frame(replicate)?;
    step.position = replicate.numbers("offset")?.unwrap_or_default();
    let digits = count.to_string().len();
    let separator = replicate.text("sep").unwrap_or_default();
    let mut frame = IDENTITY;
    let mut copies = Vec::new();
    for index in 0..count {
        folder.count_element().map_err(|reason| replicate.refuse(reason))?;
        let mut copy = placed(replicate, &frame);
        let end = format!("{separator}{index:0digits$}");
        for child in &replicate.children {
            let child = renamed(child, &end, folder).map_err(|reason| replicate.refuse(reason))?;
            copy.children.push(child);
        }
        copies.push(copy);
        frame = frame.then(&step);
        if let Some(rotation) = turned(replicate, index + 1, angles)? {
            frame.rotation = rotation;
        }
    }
    Ok(copies)
}

/// A joint whose copies would belong to one body.
fn joint_in(element: &Element) -> Option<&Element> {
    element.children.iter().find_map(|child| match child.tag.as_str() {
        "joint" | "freejoint" => Some(child),
        "frame" => joint_in(child),
        _ => None,
    })
}

/// Rotation of a copy. As in MuJoCo, it has the angles of `euler` times the copy's index; `None` about at most one axis, where
/// the product of the steps is the same rotation.
fn turned(replicate: &Element, index: i64, angles: &Angles) -> Result<Option<[f64; 4]>, String> {
    let step: [f64; 3] = replicate.numbers("euler")?.unwrap_or_default();
    if step.iter().filter(|angle| **angle != 0.0).count() < 2 {
        return Ok(None);
    }
    // Many turns would leave the bounds of an angle.
    let turn = if angles.degrees { 360.0 } else { std::f64::consts::TAU };
    let euler = text(&step.map(|angle| (angle * index as f64) % turn));
    let turned = replicate.with([("euler".to_owned(), euler)].into());
    angles.frame(&turned).map(|frame| Some(frame.rotation))
}

/// A frame without elements.
fn placed(replicate: &Element, frame: &Frame) -> Element {
    let [x, y, z, w] = frame.rotation;
    let attributes = [("pos", text(&frame.position)), ("quat", text(&[w, x, y, z]))];
    let attributes = attributes.map(|(name, text)| (name.to_owned(), text)).into();
    let mut placed = replicate.with(attributes);
    "frame".clone_into(&mut placed.tag);
    placed
}

fn text(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

/// A copy of an element and of all in it, with this end of the names.
fn renamed(element: &Element, end: &str, folder: &mut Folder<'_>) -> Result<Element, String> {
    let bytes =
        element.attributes.iter().map(|(name, text)| name.len() + text.len()).sum::<usize>();
    folder.count_copy(bytes + end.len())?;
    let mut copy = element.alone();
    if let Some(name) = copy.attributes.get_mut("name") {
        name.push_str(end);
    }
    for child in &element.children {
        copy.children.push(renamed(child, end, folder)?);
    }
    Ok(copy)
}
