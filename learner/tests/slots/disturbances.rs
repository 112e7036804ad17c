//! What may happen to a cluster, and how often.

use proptest::prelude::*;

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
    Beat(usize),
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

pub(crate) fn event() -> impl Strategy<Value = Event> {
    let seat = || 0..SEATS;
    let message = || prop_oneof![3 => Just(0), 1 => 0..MOST_UNDER_WAY];
    prop_oneof![
        24 => seat().prop_map(Event::Act),
        4 => seat().prop_map(Event::Beat),
        36 => message().prop_map(Event::Arrive),
        4 => message().prop_map(Event::ArriveTwice),
        2 => message().prop_map(Event::Lose),
        1 => seat().prop_map(Event::Kill),
        1 => seat().prop_map(Event::Freeze),
        2 => seat().prop_map(Event::Thaw),
        2 => seat().prop_map(Event::Join),
        4 => Just(Event::Learn),
        1 => (0..12_u32).prop_map(|once| if once == 0 { Event::Restart } else { Event::Learn }),
        4 => (1..8_u32).prop_map(Event::Pass),
    ]
}
