//! Incidents and refusals, each in one line of the log: the actor or peer, its work, and the consequence.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::net::SocketAddr;

use proto::{ActorId, LeaseFailure, LeaseStatus, LeasedWork, Refusal};

use crate::lease::slots::{ConnectionId, Incident};

/// The peer of a call, and the call, for the log.
#[derive(Clone, Copy, Debug)]
pub struct Caller {
    /// The connection that the call came over.
    pub connection: ConnectionId,
    /// The other end of the connection; `None` where there is no socket.
    pub peer: Option<SocketAddr>,
    /// The name of the call, such as `register`.
    pub call: &'static str,
}

impl fmt::Display for Caller {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.peer {
            Some(peer) => write!(formatter, "{} from {peer}", self.call),
            None => formatter.write_str(self.call),
        }
    }
}

/// Names of registered actors, and the senders of the environments' states.
#[derive(Debug, Default)]
pub(super) struct ActorNames {
    actors: BTreeMap<ActorId, String>,
    /// The actor that sent the latest end state of an environment, in words: it may be gone.
    senders: BTreeMap<u32, String>,
}

impl ActorNames {
    pub(super) fn insert(&mut self, actor: ActorId, name: String) {
        self.actors.insert(actor, name);
    }

    /// The end states of these environments came from `actor`.
    pub(super) fn note_sender(&mut self, actor: ActorId, environments: &[u32]) {
        let name = self.name_of(actor);
        self.senders.extend(environments.iter().map(|environment| (*environment, name.clone())));
    }

    /// The senders of the start states of these environments.
    fn senders(&self, environments: &[u32]) -> String {
        let of =
            |environment| self.senders.get(environment).map_or("the checkpoint", String::as_str);
        let names = environments.iter().map(of).collect::<BTreeSet<_>>();
        names.into_iter().collect::<Vec<_>>().join(", ")
    }

    /// The line for an incident. The name of an actor that is gone is forgotten.
    pub(super) fn describe(&mut self, incident: &Incident) -> Notice {
        match incident {
            Incident::Gone { actor, leases } => {
                let who = self.name_of(*actor);
                self.actors.remove(actor);
                match leases[..] {
                    [] => Notice::Usual(format!("{who} is gone; it held no lease")),
                    _ => Notice::Loss(format!("{who} is gone, {}; {FREE}", each(leases))),
                }
            }
            Incident::Expired(lease) => {
                let who = self.name_of(lease.actor);
                let still = lease.still_secs;
                let slow = match (lease.chunks, lease.work) {
                    (0, LeasedWork::Slot(_)) => {
                        "; if its environments are this slow, lower environments.message_steps in a new run or raise \
                         lease.ttl_secs"
                    }
                    _ => "",
                };
                Notice::Loss(format!(
                    "{who} got nothing done for {still:.1} s, {}; the lease ends, {FREE}{slow}",
                    each(std::slice::from_ref(lease))
                ))
            }
            Incident::Returned { lease, failure, detail, environments } => {
                let who = self.name_of(lease.actor);
                let at = at(lease);
                let from = match failure {
                    LeaseFailure::StartState => {
                        format!("; the start states are from {}", self.senders(environments))
                    }
                    LeaseFailure::Environment => String::new(),
                };
                Notice::Loss(format!("{who} returned its lease, {at}: {detail}; {FREE}{from}"))
            }
            Incident::Quarantined { actor, pause } => {
                let who = self.name_of(*actor);
                let secs = pause.as_secs_f64();
                Notice::Loss(format!(
                    "{who} is in quarantine: too many of its messages in a row were refused or of its leases expired; \
                     it gets no work for {secs:.1} s"
                ))
            }
        }
    }

    /// The line for a refusal, which `ended` a lease.
    pub(super) fn refusal(
        &self,
        caller: &Caller,
        refusal: &Refusal,
        ended: Option<&LeaseStatus>,
    ) -> Notice {
        let Refusal { reason, field, detail } = refusal;
        let next = match ended {
            Some(lease) => {
                let who = self.name_of(lease.actor);
                format!("{who} was {}; the lease ends, {FREE}", at(lease))
            }
            None => "no lease is touched".to_owned(),
        };
        let line = format!("{caller} is refused: {detail}; {next}");
        Notice::Refused { reason: reason.name(), field: field.clone(), line }
    }

    pub(super) fn name_of(&self, actor: ActorId) -> String {
        match self.actors.get(&actor) {
            Some(name) => format!("actor {actor} ({name})"),
            None => format!("actor {actor}"),
        }
    }
}

const FREE: &str = "its work is free again, from the first step";

/// A line of the log, by its level.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Notice {
    /// Nothing is lost.
    Usual(String),
    /// Work is lost.
    Loss(String),
    /// A refusal, whose reason and field are fields of the line.
    Refused { reason: &'static str, field: String, line: String },
}

impl Notice {
    pub(super) fn log(&self) {
        match self {
            Self::Usual(line) => tracing::info!("{line}"),
            Self::Loss(line) => tracing::warn!("{line}"),
            Self::Refused { reason, field, line } => tracing::warn!(reason, %field, "{line}"),
        }
    }
}

fn each(leases: &[LeaseStatus]) -> String {
    leases.iter().map(at).collect::<Vec<_>>().join(", ")
}

fn at(lease: &LeaseStatus) -> String {
    let sent = match (lease.work, lease.chunks) {
        (LeasedWork::Episode(_), _) => String::new(),
        (LeasedWork::Slot(_), 1) => " after 1 chunk".to_owned(),
        (LeasedWork::Slot(_), chunks) => format!(" after {chunks} chunks"),
    };
    format!("at {} (lease {}){sent}", work(lease.work), lease.lease)
}

/// Work in words.
pub(super) fn work(work: LeasedWork) -> String {
    match work {
        LeasedWork::Slot(slot) => format!("slot {slot}"),
        LeasedWork::Episode(episode) => format!("evaluation episode {episode}"),
    }
}

#[cfg(test)]
mod tests {
    use proto::LeaseId;

    use super::*;

    const OWN: ActorId = ActorId(3);

    fn names() -> ActorNames {
        let mut names = ActorNames::default();
        names.insert(OWN, "local-0".to_owned());
        names.insert(ActorId(9), "rogue".to_owned());
        names.note_sender(ActorId(9), &[4]);
        names
    }

    fn lease(work: LeasedWork) -> LeaseStatus {
        LeaseStatus { lease: LeaseId(7), actor: OWN, work, chunks: 2, still_secs: 20.0 }
    }

    #[test]
    fn each_loss_is_a_line_with_the_actor_what_it_was_at_and_what_happens_next() {
        let (slot, episode) = (lease(LeasedWork::Slot(5)), lease(LeasedWork::Episode(1)));
        let (failure, detail) = (LeaseFailure::StartState, "no state".to_owned());
        let returned =
            Incident::Returned { lease: slot, failure, detail, environments: vec![4, 5] };
        for (incident, line) in [
            (
                Incident::Gone { actor: OWN, leases: vec![slot, episode] },
                "is gone, at slot 5 (lease 7) after 2 chunks, at evaluation episode 1 (lease 7); \
                 its work is free again, from the first step",
            ),
            (
                Incident::Expired(slot),
                "got nothing done for 20.0 s, at slot 5 (lease 7) after 2 chunks; the lease ends, its work is free \
                 again, from the first step",
            ),
            (
                Incident::Expired(LeaseStatus { chunks: 0, ..slot }),
                "got nothing done for 20.0 s, at slot 5 (lease 7) after 0 chunks; the lease ends, its work is free \
                 again, from the first step; if its environments are this slow, lower environments.message_steps in \
                 a new run or raise lease.ttl_secs",
            ),
            (
                Incident::Quarantined { actor: OWN, pause: std::time::Duration::from_secs(40) },
                "is in quarantine: too many of its messages in a row were refused or of its leases expired; it gets \
                 no work for 40.0 s",
            ),
            (
                returned,
                "returned its lease, at slot 5 (lease 7) after 2 chunks: no state; its work is free \
                 again, from the first step; the start states are from actor 9 (rogue), the checkpoint",
            ),
        ] {
            let line = format!("actor 3 (local-0) {line}");
            assert_eq!(names().describe(&incident), Notice::Loss(line));
        }
    }

    #[test]
    fn an_actor_that_leaves_without_a_lease_is_no_loss_and_its_name_goes_with_it() {
        let mut names = names();
        let gone = names.describe(&Incident::Gone { actor: OWN, leases: Vec::new() });
        assert_eq!(gone, Notice::Usual("actor 3 (local-0) is gone; it held no lease".to_owned()));
        assert_eq!(names.name_of(OWN), "actor 3");
    }
}
