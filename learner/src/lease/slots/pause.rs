//! A table that hands out nothing for a while. What is leased may be finished, and whoever asks for more waits.

use super::{Effect, SlotTable};

impl SlotTable {
    /// No more leases until [`Self::resume`]; those that are open may be finished.
    pub fn pause(&mut self) {
        self.paused = true;
    }

    /// Leases again.
    pub fn resume(&mut self) {
        self.paused = false;
        self.effects.push(Effect::WorkFreed);
    }

    /// Whether nothing is leased until somebody resumes.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.paused
    }
}
