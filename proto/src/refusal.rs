//! Why a message was refused: a stable reason, the path of the field, and what is wrong with it.

use std::collections::HashMap;
use std::fmt;

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

/// Stands in every `google.rpc.ErrorInfo` that we send.
pub const ERROR_DOMAIN: &str = "s2mia";

/// Longest text taken over from a peer, bytes: status details travel in a header, which has little room.
const MAX_TEXT_BYTES: usize = 400;

/// A stable code for why a message was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Reason {
    /// A required field is missing.
    MissingField,
    /// A value is unknown or outside its range.
    BadValue,
    /// A tensor has another element type.
    BadType,
    /// A tensor's shape is not the expected one, overflows, or does not fit its bytes.
    BadShape,
    /// A float is NaN, infinite or absurdly large.
    NotFinite,
    /// Flags, final steps or counters contradict each other.
    Inconsistent,
    /// A chunk does not follow the one before it.
    OutOfOrder,
    /// The learner computes other log-probabilities or recurrent states from the same observations.
    CanaryMismatch,
    /// The bytes do not have the digest they came with.
    DigestMismatch,
    /// The same lease gave the same chunk twice, with different content.
    DigestConflict,
    /// The lease has ended or never was.
    UnknownLease,
    /// The lease was given to an actor of another connection.
    OtherConnection,
    /// The message is for another start of the learner.
    OtherIncarnation,
    /// The registration has ended or never was.
    UnknownActor,
    /// The weights are not held any more.
    UnknownWeights,
    /// The work was done with other weights than the lease's.
    StaleWeights,
    /// The actor offers another environment.
    OtherEnvironment,
    /// The actor speaks another protocol version.
    OtherProtocol,
    /// The actor's program or machine computes other numbers.
    OtherFingerprint,
    /// More leases than one actor may hold.
    TooManyLeases,
    /// The message is larger than any may be.
    TooLarge,
    /// The message is no message of ours.
    Undecodable,
    /// No message came for too long.
    TooSlow,
    /// The learner has no room for more at the moment.
    Busy,
}

/// Every reason with its stable name and status code.
const REASONS: [(Reason, &str, Code); 24] = [
    (Reason::MissingField, "MISSING_FIELD", Code::InvalidArgument),
    (Reason::BadValue, "BAD_VALUE", Code::InvalidArgument),
    (Reason::BadType, "BAD_TYPE", Code::InvalidArgument),
    (Reason::BadShape, "BAD_SHAPE", Code::InvalidArgument),
    (Reason::NotFinite, "NOT_FINITE", Code::InvalidArgument),
    (Reason::Inconsistent, "INCONSISTENT", Code::InvalidArgument),
    (Reason::OutOfOrder, "OUT_OF_ORDER", Code::InvalidArgument),
    (Reason::CanaryMismatch, "CANARY_MISMATCH", Code::InvalidArgument),
    (Reason::DigestMismatch, "DIGEST_MISMATCH", Code::DataLoss),
    (Reason::DigestConflict, "DIGEST_CONFLICT", Code::DataLoss),
    (Reason::UnknownLease, "UNKNOWN_LEASE", Code::Aborted),
    (Reason::OtherConnection, "OTHER_CONNECTION", Code::Aborted),
    (Reason::OtherIncarnation, "OTHER_INCARNATION", Code::Aborted),
    (Reason::UnknownActor, "UNKNOWN_ACTOR", Code::Aborted),
    (Reason::UnknownWeights, "UNKNOWN_WEIGHTS", Code::Aborted),
    (Reason::StaleWeights, "STALE_WEIGHTS", Code::FailedPrecondition),
    (Reason::OtherEnvironment, "OTHER_ENVIRONMENT", Code::FailedPrecondition),
    (Reason::OtherProtocol, "OTHER_PROTOCOL", Code::FailedPrecondition),
    (Reason::OtherFingerprint, "OTHER_FINGERPRINT", Code::FailedPrecondition),
    (Reason::TooManyLeases, "TOO_MANY_LEASES", Code::ResourceExhausted),
    (Reason::TooLarge, "TOO_LARGE", Code::ResourceExhausted),
    (Reason::Undecodable, "UNDECODABLE", Code::InvalidArgument),
    (Reason::TooSlow, "TOO_SLOW", Code::DeadlineExceeded),
    (Reason::Busy, "BUSY", Code::Unavailable),
];

impl Reason {
    /// The stable name, as in `ErrorInfo.reason`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.entry().1
    }

    /// The gRPC status code.
    #[must_use]
    pub fn code(self) -> Code {
        self.entry().2
    }

    fn entry(self) -> &'static (Reason, &'static str, Code) {
        REASONS.iter().find(|entry| entry.0 == self).expect("every reason stands in the table")
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why a message was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason}: {field}: {detail}")]
pub struct Refusal {
    /// The stable code.
    pub reason: Reason,
    /// Path of the field, for example `chunk.agents[1].observation`.
    pub field: String,
    /// What is wrong, with the figures.
    pub detail: String,
}

impl Refusal {
    /// A refusal of `field`.
    #[must_use]
    pub fn new(reason: Reason, field: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { reason, field: cut(field.into()), detail: cut(detail.into()) }
    }

    /// What a peer's status says, if it carries one of our refusals.
    #[must_use]
    pub fn from_status(status: &Status) -> Option<Self> {
        let info = status.get_details_error_info().filter(|info| info.domain == ERROR_DOMAIN)?;
        let reason = REASONS.iter().find(|entry| entry.1 == info.reason)?.0;
        let request = status.get_details_bad_request()?;
        let violation = request.field_violations.into_iter().next()?;
        Some(Self::new(reason, violation.field, violation.description))
    }
}

/// A status that carries no refusal of ours, as one line.
#[must_use]
pub fn in_words(status: &Status) -> String {
    match (status.code(), status.message()) {
        (Code::Unimplemented, "") => {
            "another program listens there, which offers no such service".to_owned()
        }
        (code, message) => format!("{code:?}: {message}"),
    }
}

impl From<Refusal> for Status {
    /// `ErrorInfo` carries reason and domain, `BadRequest` the field and the detail.
    fn from(refusal: Refusal) -> Self {
        let mut details = ErrorDetails::new();
        details.set_error_info(refusal.reason.name(), ERROR_DOMAIN, HashMap::new());
        details.add_bad_request_violation(&refusal.field, &refusal.detail);
        Status::with_error_details(refusal.reason.code(), refusal.to_string(), details)
    }
}

/// One line, and not too long a one: what a peer sent may stand in it.
fn cut(text: String) -> String {
    let mut text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if text.len() > MAX_TEXT_BYTES {
        let end = (0..=MAX_TEXT_BYTES).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
        text.truncate(end);
        text.push_str("...");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_survives_the_way_through_a_status() {
        for (reason, name, code) in REASONS {
            let refusal =
                Refusal::new(reason, "chunk.agents[1].observation", "[2, 3], expected [2, 4]");
            let status = Status::from(refusal.clone());
            assert_eq!((status.code(), reason.name()), (code, name));
            assert_eq!(Refusal::from_status(&status), Some(refusal));
        }
    }

    #[test]
    fn a_status_of_somebody_else_is_no_refusal() {
        assert_eq!(Refusal::from_status(&Status::aborted("a proxy")), None);
    }

    #[test]
    fn long_texts_of_a_peer_are_cut_between_characters() {
        let refusal = Refusal::new(Reason::BadValue, "é".repeat(10_000), "");
        assert!(refusal.field.len() <= MAX_TEXT_BYTES + 3 && refusal.field.ends_with("é..."));
    }
}
