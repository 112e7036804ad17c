//! Id types, so that ids with different meanings cannot be confused.

use std::fmt;

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u64);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

/// Random id of an actor's process, the same over all its connections. No result depends on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ProcessId(pub [u8; 16]);

id! {
    /// Id of a lease, unique within an incarnation of the learner.
    LeaseId
}
id! {
    /// Id of an actor's registration.
    ActorId
}
id! {
    /// Id of one start of the learner. Leases of other incarnations are invalid.
    Incarnation
}
id! {
    /// Number of learner updates in a set of weights.
    PolicyVersion
}
