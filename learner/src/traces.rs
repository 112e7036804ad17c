//! Which trace an iteration belongs to, so that actors' spans stand in the learner's. Ids reach no result, and nobody asks for
//! them where spans go nowhere.

use std::hash::{BuildHasher, Hasher, RandomState};

/// The traces of one start of a learner, one for each iteration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Traces {
    /// Tells them from those of another start.
    start: u64,
}

impl Traces {
    /// Traces that no other start has.
    pub(crate) fn begin() -> Self {
        // Any source of chance will do; ids of zero are void.
        Self { start: RandomState::new().build_hasher().finish().max(1) }
    }

    /// An iteration's whole span, as W3C Trace Context writes the parent of another: `00-TRACE-SPAN-01`, where the trace is the
    /// iteration and the start, the span is the start, and `01` says that it is recorded.
    pub(crate) fn parent(self, iteration: u64) -> String {
        let start = self.start;
        format!("00-{iteration:016x}{start:016x}-{start:016x}-01")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_iteration_has_a_trace_of_its_own() {
        let traces = Traces { start: 0xabc };
        let expected = "00-00000000000000080000000000000abc-0000000000000abc-01";
        assert_eq!(traces.parent(8), expected);
        assert_ne!(traces.parent(9)[3..35], expected[3..35]);
    }
}
