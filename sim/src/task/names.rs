//! Names of a robot's parts, as task files use them.

use super::definition::refused;
use crate::error::SimError;
use crate::robot::{Place, Robot};
use crate::spelling;

/// Known names of one kind.
#[derive(Clone, Copy, Debug)]
pub(super) struct Names<'a> {
    kind: &'static str,
    known: &'a [String],
}

impl<'a> Names<'a> {
    /// Names of one kind, such as `feature`.
    pub(super) fn new(kind: &'static str, known: &'a [String]) -> Self {
        Self { kind, known }
    }

    /// Names of a robot's coordinates.
    pub(super) fn coordinates(robot: &'a Robot) -> Self {
        Self::new("coordinate", robot.coordinate_names())
    }

    /// Index of a name; the error names the key `place` and what to write instead.
    pub(super) fn index(&self, place: &str, name: &str) -> Result<usize, SimError> {
        let found = self.known.iter().position(|known| known == name);
        found.ok_or_else(|| {
            let hint = spelling::choice(name, self.known.iter().map(String::as_str));
            refused(format!("{place}: the robot has no {} `{name}`; {hint}", self.kind))
        })
    }

    /// The body with this name, which the key `place` states.
    pub(super) fn body(robot: &Robot, place: &str, name: &str) -> Result<Place, SimError> {
        Names::new("body", robot.bodies()).index(place, name).map(|index| robot.place(index))
    }
}
