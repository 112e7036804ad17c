//! What may happen to a cluster.

/// Places for actors.
pub(crate) const SEATS: usize = 4;
/// Messages under way; what is sent beyond is lost.
pub(crate) const MOST_UNDER_WAY: usize = 48;

/// One thing that happens. Numbers choose among whatever there is.
#[derive(Clone, Debug)]
pub(crate) enum Event {
    /// An actor takes its next step: it asks for work, or sends some.
    Act(usize),
    /// An actor gives a sign of life.
    Heartbeat(usize),
    /// A message arrives; the first is the oldest.
    Arrive(usize),
    /// A message arrives, and will once more.
    ArriveTwice(usize),
    /// A message is lost.
    Lose(usize),
    /// An actor is killed; what it sent may still arrive.
    Kill(usize),
    /// An actor stands still, its connection stays.
    Freeze(usize),
    /// It goes on.
    Thaw(usize),
    /// A dead actor comes back on a new connection.
    Join(usize),
    /// The trainer takes a complete iteration and opens the next.
    Learn,
    /// The learner dies; the next one goes on with the iteration that was open.
    Restart,
    /// Time passes, in tenths of the time to live.
    Pass(u32),
}
