//! Numbers with a meaning. Two ids of different meaning never meet in one signature.

use std::fmt;

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u64);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

id! {
    /// One grant of one piece of work to one actor. Never used twice by one start of the learner.
    LeaseId
}
id! {
    /// One registration of an actor.
    ActorId
}
id! {
    /// One start of the learner. Leases of another one are void.
    Incarnation
}
id! {
    /// Learner updates behind a set of weights.
    PolicyVersion
}
