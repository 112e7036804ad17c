//! Keyframes: poses, motions and controls that a model names.

use super::super::blueprint::Keyframe;
use super::super::document::{Element, check_unique};
use super::blockers::Blockers;

const KNOWN: [&str; 8] = ["name", "time", "qpos", "qvel", "act", "ctrl", "mpos", "mquat"];

/// Reads all keyframes. Their lengths are checked where a task starts from one.
pub(super) fn read(root: &Element, blockers: &Blockers) -> Vec<Keyframe> {
    let keys = root.all("keyframe").flat_map(|section| &section.children).enumerate();
    let read = keys.filter_map(|(index, key)| Some((key, blockers.keep(keyframe(index, key))?)));
    let read: Vec<(&Element, Keyframe)> = read.collect();
    blockers.keep(check_unique(read.iter().map(|(key, frame)| (*key, frame.name.as_str()))));
    read.into_iter().map(|(_, frame)| frame).collect()
}

/// Says that poses of mocap bodies have no effect, if a keyframe has any.
pub(super) fn left_out(root: &Element) -> Option<String> {
    let keys = root.all("keyframe").flat_map(|section| &section.children);
    let moves = |key: &&Element| key.text("mpos").or(key.text("mquat")).is_some();
    let count = keys.filter(moves).count();
    (count > 0).then(|| {
        format!(
            "`mpos` or `mquat` has no effect, mocap bodies stay where they are: {count} of the keyframes"
        )
    })
}

fn keyframe(index: usize, key: &Element) -> Result<Keyframe, String> {
    key.only(&[&KNOWN])?;
    let numbers = |name: &str| key.list(name).map(Option::unwrap_or_default);
    Ok(Keyframe {
        name: key.text("name").map_or_else(|| index.to_string(), str::to_owned),
        positions: numbers("qpos")?,
        velocities: numbers("qvel")?,
        controls: numbers("ctrl")?,
        activations: numbers("act")?,
    })
}
