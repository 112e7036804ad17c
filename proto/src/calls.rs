//! Contents of calls other than work and results: registrations, answers, acknowledgements, heartbeats.

use bytes::Bytes;

use crate::read::{array, digest, required, short_name, unknown};
use crate::{
    ActorId, Digest, EnvironmentSpec, Incarnation, Lease, LeaseId, ProcessId, Reason, Refusal,
    RunDescription, WeightsName, wire,
};

/// An actor's registration request.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    /// Name of the actor in the learner's log.
    pub client: String,
    /// Version and commit of the program; empty if it does not say.
    pub build: String,
    /// Its protocol version.
    pub protocol_version: u32,
    /// Its environment.
    pub environment: EnvironmentSpec,
    /// `None` for third-party clients; the run is then not exactly repeatable.
    pub rollout_fingerprint: Option<Digest>,
    /// The process of the actor; `None` if the actor sent no id.
    pub process: Option<ProcessId>,
}

impl Registration {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::RegisterRequest {
        let fingerprint = self.rollout_fingerprint.map(|digest| Bytes::copy_from_slice(&digest.0));
        wire::RegisterRequest {
            client: self.client.clone(),
            build: self.build.clone(),
            protocol_version: self.protocol_version,
            environment: Some(self.environment.to_wire()),
            rollout_fingerprint: fingerprint,
            process: self.process.map(|process| Bytes::copy_from_slice(&process.0)),
        }
    }

    /// Reads the message.
    ///
    /// # Errors
    /// If the name or the build is invalid, a part is missing, the fingerprint is not a SHA-256, or the id of the process
    /// does not have 16 bytes.
    pub fn from_wire(wire: wire::RegisterRequest) -> Result<Self, Refusal> {
        short_name(&wire.client, "client")?;
        if !wire.build.is_empty() {
            short_name(&wire.build, "build")?;
        }
        let environment = required(wire.environment, "environment")?;
        let fingerprint =
            wire.rollout_fingerprint.map(|bytes| digest(&bytes, "rollout_fingerprint"));
        let process = wire.process.map(|bytes| array(&bytes, "an id of a process", "process"));
        Ok(Self {
            client: wire.client,
            build: wire.build,
            protocol_version: wire.protocol_version,
            environment: EnvironmentSpec::from_wire(environment, "environment")?,
            rollout_fingerprint: fingerprint.transpose()?,
            process: process.transpose()?.map(ProcessId),
        })
    }

    /// Checks that the actor matches `run`.
    ///
    /// # Errors
    /// If the protocol version, the build of an actor with a fingerprint, the environment (naming the first difference)
    /// or a given fingerprint differs.
    pub fn check(&self, run: &RunDescription) -> Result<(), Refusal> {
        let refuse = |reason, field: &str, detail| Err(Refusal::new(reason, field, detail));
        let (found, expected) = (self.protocol_version, run.protocol_version);
        if found != expected {
            let detail = format!("the actor has version {found}, the learner {expected}");
            return refuse(Reason::OtherProtocol, "protocol_version", detail);
        }
        let is_exact = self.rollout_fingerprint.is_some();
        if is_exact && !run.other_builds && self.build != run.build {
            let detail = format!(
                "the actor {} is of build {:?}, the learner of {:?}; start it from the learner's build, or allow \
                 others that compute the same results with learner.other_builds=true",
                self.client, self.build, run.build
            );
            return refuse(Reason::OtherBuild, "build", detail);
        }
        if let Some(difference) = run.environment.first_difference(&self.environment) {
            let field = format!("environment.{}", difference.field);
            return refuse(Reason::OtherEnvironment, &field, difference.to_string());
        }
        match self.rollout_fingerprint {
            Some(found) if found != run.rollout_fingerprint => {
                let expected = run.rollout_fingerprint;
                let detail = format!(
                    "the actor's is {found}, the learner's {expected}: an actor of another version would \
                     change the run's numbers"
                );
                refuse(Reason::OtherFingerprint, "rollout_fingerprint", detail)
            }
            _ => Ok(()),
        }
    }
}

/// A registered actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Registered {
    /// Id of the actor.
    pub actor: ActorId,
    /// This start of the learner.
    pub incarnation: Incarnation,
}

impl Registered {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::RegisterResponse {
        wire::RegisterResponse { actor_id: self.actor.0, incarnation: self.incarnation.0 }
    }

    /// Reads the message.
    #[must_use]
    pub fn from_wire(wire: &wire::RegisterResponse) -> Self {
        Self { actor: ActorId(wire.actor_id), incarnation: Incarnation(wire.incarnation) }
    }
}

/// The answer to a lease request.
#[derive(Clone, Debug, PartialEq)]
pub enum LeaseAnswer {
    /// Work for the actor.
    Lease(Lease),
    /// No work is available.
    Retry {
        /// Time before the next request.
        wait_millis: u32,
    },
    /// The run is over.
    Done,
}

impl LeaseAnswer {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::LeaseSlotsResponse {
        use wire::lease_slots_response::Answer;
        let answer = match self {
            Self::Lease(lease) => Answer::Lease(lease.to_wire()),
            Self::Retry { wait_millis } => Answer::Retry(wire::Retry { wait_millis: *wait_millis }),
            Self::Done => Answer::Done(wire::Done {}),
        };
        wire::LeaseSlotsResponse { answer: Some(answer) }
    }

    /// Reads the message of `run`.
    ///
    /// # Errors
    /// If the answer is missing, or as [`Lease::from_wire`].
    pub fn from_wire(
        wire: wire::LeaseSlotsResponse,
        run: &RunDescription,
    ) -> Result<Self, Refusal> {
        use wire::lease_slots_response::Answer;
        Ok(match required(wire.answer, "answer")? {
            Answer::Lease(lease) => Self::Lease(Lease::from_wire(lease, run)?),
            Answer::Retry(retry) => Self::Retry { wait_millis: retry.wait_millis },
            Answer::Done(_) => Self::Done,
        })
    }
}

/// Header of a pushed message; its content is read separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PushHeader {
    /// The lease whose result it contains.
    pub lease: LeaseId,
    /// Incarnation of the lease.
    pub incarnation: Incarnation,
    /// The weights used for acting.
    pub weights: WeightsName,
    /// SHA-256 of the content.
    pub digest: Digest,
}

impl PushHeader {
    /// The header for the results of `lease`.
    #[must_use]
    pub fn of(lease: &Lease, digest: Digest) -> Self {
        Self { lease: lease.id, incarnation: lease.incarnation, weights: lease.weights, digest }
    }

    /// The message with this header and `content`.
    #[must_use]
    pub fn to_wire(
        &self,
        content: wire::push_trajectory_request::Content,
    ) -> wire::PushTrajectoryRequest {
        wire::PushTrajectoryRequest {
            lease_id: self.lease.0,
            incarnation: self.incarnation.0,
            weights: Some(self.weights.to_wire()),
            digest: Bytes::copy_from_slice(&self.digest.0),
            content: Some(content),
            film: None,
        }
    }

    /// Reads the header and returns the content unread.
    ///
    /// # Errors
    /// If a part is missing or a digest is not a SHA-256.
    pub fn from_wire(
        wire: wire::PushTrajectoryRequest,
    ) -> Result<(Self, wire::push_trajectory_request::Content), Refusal> {
        let header = Self {
            lease: LeaseId(wire.lease_id),
            incarnation: Incarnation(wire.incarnation),
            weights: WeightsName::from_wire(wire.weights, "weights")?,
            digest: digest(&wire.digest, "digest")?,
        };
        Ok((header, required(wire.content, "content")?))
    }
}

/// Acknowledges one pushed message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ack {
    /// The lease.
    pub lease: LeaseId,
    /// Sequence number of the chunk; 0 for an evaluation.
    pub sequence: u32,
    /// Whether the message was new.
    pub state: AckState,
    /// Whether the lease's result is complete.
    pub lease_finished: bool,
}

/// State of an acknowledged message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AckState {
    /// New.
    Accepted,
    /// Already received before.
    Repeated,
}

impl Ack {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::PushTrajectoryResponse {
        let state = match self.state {
            AckState::Accepted => wire::AckState::Accepted,
            AckState::Repeated => wire::AckState::Repeated,
        };
        wire::PushTrajectoryResponse {
            lease_id: self.lease.0,
            sequence: self.sequence,
            state: state.into(),
            lease_finished: self.lease_finished,
        }
    }

    /// Reads the message.
    ///
    /// # Errors
    /// If the state is unknown.
    pub fn from_wire(wire: &wire::PushTrajectoryResponse) -> Result<Self, Refusal> {
        let state = match wire::AckState::try_from(wire.state) {
            Ok(wire::AckState::Accepted) => AckState::Accepted,
            Ok(wire::AckState::Repeated) => AckState::Repeated,
            _ => return Err(unknown("state", wire.state)),
        };
        let lease = LeaseId(wire.lease_id);
        let sequence = wire.sequence;
        Ok(Self { lease, sequence, state, lease_finished: wire.lease_finished })
    }
}

/// An actor's heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// The sender.
    pub actor: ActorId,
    /// Incarnation of the registration.
    pub incarnation: Incarnation,
    /// The lease to keep alive.
    pub lease: LeaseId,
    /// Completed steps of the lease.
    pub slot_step: u32,
}

impl Heartbeat {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::HeartbeatRequest {
        wire::HeartbeatRequest {
            actor_id: self.actor.0,
            incarnation: self.incarnation.0,
            lease_id: self.lease.0,
            slot_step: self.slot_step,
        }
    }

    /// Reads the message.
    #[must_use]
    pub fn from_wire(wire: &wire::HeartbeatRequest) -> Self {
        Self {
            actor: ActorId(wire.actor_id),
            incarnation: Incarnation(wire.incarnation),
            lease: LeaseId(wire.lease_id),
            slot_step: wire.slot_step,
        }
    }
}

/// Answers a heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeartbeatAnswer {
    /// If false: discard the work and request a new lease.
    pub lease_valid: bool,
    /// Whether the run is over.
    pub is_over: bool,
}

impl HeartbeatAnswer {
    /// Converts to the message.
    #[must_use]
    pub fn to_wire(&self) -> wire::HeartbeatResponse {
        let state = if self.is_over { wire::RunState::Done } else { wire::RunState::Running };
        wire::HeartbeatResponse { lease_valid: self.lease_valid, run_state: state.into() }
    }

    /// Reads the message.
    ///
    /// # Errors
    /// If the run state is unknown.
    pub fn from_wire(wire: &wire::HeartbeatResponse) -> Result<Self, Refusal> {
        let is_over = match wire::RunState::try_from(wire.run_state) {
            Ok(wire::RunState::Running | wire::RunState::Draining) => false,
            Ok(wire::RunState::Done) => true,
            _ => return Err(unknown("run_state", wire.run_state)),
        };
        Ok(Self { lease_valid: wire.lease_valid, is_over })
    }
}
