//! Why a message was rejected: a stable reason, the path of the field, and details.

use std::collections::HashMap;
use std::fmt;

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::name;

/// Domain of every `google.rpc.ErrorInfo` that this program sends.
const ERROR_DOMAIN: &str = "s2mia";

/// Longest text from a peer, bytes. Status details are sent in a header, which has limited size.
const MAX_TEXT_BYTES: usize = 400;

/// A stable code for why a message was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Reason {
    /// A required field is missing.
    MissingField,
    /// A value is unknown or outside its range.
    BadValue,
    /// A tensor has the wrong element type.
    BadType,
    /// A tensor's shape is not the expected one, overflows, or does not match its bytes.
    BadShape,
    /// A float is NaN or infinite.
    NotFinite,
    /// Flags, final steps or counters contradict each other.
    Inconsistent,
    /// A chunk does not follow the previous one.
    OutOfOrder,
    /// The learner computes other log-probabilities or recurrent states from the same observations.
    CanaryMismatch,
    /// The bytes do not match the digest in the message.
    DigestMismatch,
    /// A lease sent the same chunk twice with different content.
    DigestConflict,
    /// The lease ended or never existed.
    UnknownLease,
    /// The lease was given to an actor of another connection.
    OtherConnection,
    /// The message is for another start of the learner.
    OtherIncarnation,
    /// The registration ended or never existed.
    UnknownActor,
    /// The learner no longer has the weights.
    UnknownWeights,
    /// The work was not done with the lease's weights.
    StaleWeights,
    /// The actor's environment differs from the run's.
    OtherEnvironment,
    /// The actor's protocol version differs.
    OtherProtocol,
    /// The actor's program has another version or commit.
    OtherBuild,
    /// The actor's program or machine computes different results.
    OtherFingerprint,
    /// More leases than one actor may hold.
    TooManyLeases,
    /// The message exceeds the size limit.
    TooLarge,
    /// The message cannot be decoded.
    Undecodable,
    /// No message came for too long.
    TooSlow,
    /// The learner has no room for more at the moment.
    Busy,
}

/// Every reason with its stable name and status code.
const REASONS: [(Reason, &str, Code); 25] = [
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
    (Reason::OtherBuild, "OTHER_BUILD", Code::FailedPrecondition),
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
        REASONS.iter().find(|entry| entry.0 == self).expect("every reason is in the table")
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why a message was rejected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason}: {field}: {detail}")]
pub struct Refusal {
    /// The stable code.
    pub reason: Reason,
    /// Path of the field, for example `chunk.agents[1].observation`.
    pub field: String,
    /// What is wrong, with the values.
    pub detail: String,
}

impl Refusal {
    /// A refusal because of `field`.
    #[must_use]
    pub fn new(reason: Reason, field: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { reason, field: truncated(&field.into()), detail: truncated(&detail.into()) }
    }

    /// The refusal in a peer's status, if it contains one.
    #[must_use]
    pub fn from_status(status: &Status) -> Option<Self> {
        let info = status.get_details_error_info().filter(|info| info.domain == ERROR_DOMAIN)?;
        let reason = REASONS.iter().find(|entry| entry.1 == info.reason)?.0;
        let request = status.get_details_bad_request()?;
        let violation = request.field_violations.into_iter().next()?;
        Some(Self::new(reason, violation.field, violation.description))
    }
}

/// A status without a refusal, as one short line.
#[must_use]
pub fn in_words(status: &Status) -> String {
    match (status.code(), status.message()) {
        (Code::Unimplemented, "") => {
            "the server at this address does not provide this service; it may be another program"
                .to_owned()
        }
        (code, message) => truncated(&format!("{code:?}: {message}")),
    }
}

impl From<Refusal> for Status {
    /// `ErrorInfo` contains reason and domain, `BadRequest` the field and the detail.
    fn from(refusal: Refusal) -> Self {
        let mut details = ErrorDetails::new();
        details.set_error_info(refusal.reason.name(), ERROR_DOMAIN, HashMap::new());
        details.add_bad_request_violation(&refusal.field, &refusal.detail);
        Status::with_error_details(refusal.reason.code(), refusal.to_string(), details)
    }
}

/// Limits text that a peer may have sent to one short line.
pub(crate) fn truncated(text: &str) -> String {
    let mut text = name::printable(text);
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
    fn every_reason_survives_the_round_trip_through_a_status() {
        for (reason, name, code) in REASONS {
            let refusal =
                Refusal::new(reason, "chunk.agents[1].observation", "[2, 3], expected [2, 4]");
            let status = Status::from(refusal.clone());
            assert_eq!((status.code(), reason.name()), (code, name));
            assert_eq!(Refusal::from_status(&status), Some(refusal));
        }
    }

    #[test]
    fn a_status_of_another_program_is_not_a_refusal() {
        assert_eq!(Refusal::from_status(&Status::aborted("a proxy")), None);
    }

    #[test]
    fn a_text_of_a_peer_is_one_line_that_shows_all_its_characters() {
        let refusal = Refusal::new(Reason::BadValue, "a\u{202e}b", "one\u{2028}two");
        assert_eq!(refusal.to_string(), "BAD_VALUE: a<U+202E>b: one two");
        let status = Status::internal("\u{1b}[2J\nall is well");
        assert_eq!(in_words(&status), "Internal: <U+001B>[2J all is well");
    }

    #[test]
    fn long_texts_of_a_peer_are_truncated_between_characters() {
        let refusal = Refusal::new(Reason::BadValue, "é".repeat(10_000), "");
        assert!(refusal.field.len() <= MAX_TEXT_BYTES + 3 && refusal.field.ends_with("é..."));
    }
}
