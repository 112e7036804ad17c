//! Where elements of a model belong, for messages about those that are misspelt or misplaced.

use super::Element;
use crate::spelling;

/// Sections of a model that are read, or have no effect on the motion.
pub(in crate::robot) const SECTIONS: [&str; 15] = [
    "compiler",
    "option",
    "size",
    "statistic",
    "visual",
    "custom",
    "default",
    "asset",
    "worldbody",
    "actuator",
    "contact",
    "equality",
    "tendon",
    "sensor",
    "keyframe",
];

/// Elements with the place that they have in a model.
const PLACES: [(&str, &[&str]); 9] = [
    ("<mujoco>", &SECTIONS),
    ("the <worldbody> or a <body>", &["body", "geom", "site", "frame", "camera", "light"]),
    ("a <body>", &["joint", "freejoint", "inertial"]),
    ("<asset>", &["mesh", "hfield", "texture", "material"]),
    (
        "<actuator>",
        &["general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder"],
    ),
    ("<contact>", &["pair", "exclude"]),
    ("<equality>", &["connect", "weld"]),
    ("<tendon>", &["fixed", "spatial"]),
    ("<keyframe>", &["key"]),
];

impl Element {
    /// Error message for this element, which nothing reads where it is: where it belongs, or how it may be spelt.
    pub(in crate::robot) fn refuse_element(&self) -> String {
        let tag = self.tag.as_str();
        if let Some((place, _)) = PLACES.iter().find(|(_, tags)| tags.contains(&tag)) {
            return self.refuse(format!("this element belongs in {place}; move it there"));
        }
        let tags = PLACES.iter().flat_map(|(_, tags)| *tags).copied();
        match spelling::nearest(tag, tags) {
            Some(nearest) => {
                self.refuse(format!("this element is unknown; did you mean `{nearest}`?"))
            }
            None => self.refuse("this element is not supported; remove it"),
        }
    }
}
