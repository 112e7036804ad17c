//! Settings of one actor process; operational, so they never change a number.

/// Where the learner is and how long to wait for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// The learner's URL, such as `http://127.0.0.1:50051`.
    pub learner: String,
    /// Seconds without the learner after which the actor gives up.
    pub max_outage_secs: f64,
    /// Name of this actor, for people.
    pub name: String,
}
