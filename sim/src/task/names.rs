//! Names of a robot's parts, as task files use them.

use super::definition::refused;
use crate::error::SimError;
use crate::robot::{Place, Robot};
use crate::spelling;

/// Most names that a message lists.
const MOST_NAMED: usize = 100;

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

    /// Index of a name; the error names the key `place` and the nearest known name.
    pub(super) fn index(&self, place: &str, name: &str) -> Result<usize, SimError> {
        let found = self.known.iter().position(|known| known == name);
        found.ok_or_else(|| {
            let nearest = spelling::nearest(name, self.known.iter().map(String::as_str));
            let hint = nearest.map(|name| format!("; did you mean `{name}`?")).unwrap_or_default();
            let known = self.list();
            refused(format!("{place}: the robot has no {} `{name}`{hint}; {known}", self.kind))
        })
    }

    /// The body with this name, which the key `place` states.
    pub(super) fn body(robot: &Robot, place: &str, name: &str) -> Result<Place, SimError> {
        Names::new("body", robot.bodies()).index(place, name).map(|index| robot.place(index))
    }

    /// What is known, for messages.
    fn list(&self) -> String {
        let known: Vec<&str> = self.known.iter().take(MOST_NAMED).map(String::as_str).collect();
        match (known.is_empty(), self.known.len() - known.len()) {
            (true, _) => "it has none".to_owned(),
            (false, 0) => format!("it has {}", known.join(", ")),
            (false, more) => format!("it has {} and {more} more", known.join(", ")),
        }
    }
}
