//! Map of an action from units of half a range to its own unit, such as that of a motor's control.

/// Linear map of one number of an action from units of half a range to its own unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActionScale {
    middle: f32,
    half: f32,
}

impl ActionScale {
    /// The map to the range from `low` to `high`.
    pub fn to([low, high]: [f32; 2]) -> Self {
        Self { middle: low / 2.0 + high / 2.0, half: high / 2.0 - low / 2.0 }
    }

    /// `middle + half width x action`, in the own unit; not clamped. For the range -1 to 1 this is exactly the action.
    pub fn apply(self, action: f32) -> f32 {
        self.middle + self.half * action
    }
}
