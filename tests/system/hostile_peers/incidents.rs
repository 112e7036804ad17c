//! Each lost, late or quarantined actor is one line of the log: the actor, its work, and the consequence.

use super::attackers::{Attacker, arbitrary_chunk, message};
use super::learner;
use crate::processes::{Learner, eventually};
use crate::runs::Runs;

/// Waits for the only log line that contains `words`.
fn line(learner: &Learner, words: &str) -> String {
    tokio::task::block_in_place(|| {
        eventually(|| {
            let log = learner.process.log();
            let found: Vec<&str> = log.lines().filter(|line| line.contains(words)).collect();
            match found[..] {
                [] => Err(format!("no line with `{words}` in:\n{log}")),
                [line] => Ok(line.to_owned()),
                _ => panic!("logged twice: {log}"),
            }
        })
    })
}

fn contains(line: &str, all: &[&str]) {
    assert!(all.iter().all(|words| line.contains(words)), "{all:?}: {line}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_actor_lost_during_a_slot_is_logged_with_the_slot() {
    let runs = Runs::new();
    let learner = learner(&runs.folder("run"), &[]);
    let mut attacker = Attacker::connect(&learner.url).await;
    let (actor, lease) = (attacker.own.actor, attacker.lease().await.id);
    drop(attacker);
    let logged = line(&learner, " is gone, at ");
    let who = format!("WARN actor {actor} (attacker) is gone");
    let what = format!("at slot 0 (lease {lease}) after 0 chunks");
    contains(&logged, &[&who, &what, "its work is free again"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_expired_lease_is_logged() {
    let runs = Runs::new();
    let learner = learner(&runs.folder("run"), &["lease.ttl_secs=0.4"]);
    let mut attacker = Attacker::connect(&learner.url).await;
    let (actor, lease) = (attacker.own.actor, attacker.lease().await.id);
    let _other_slot = attacker.lease().await;
    // No slot is free until the first lease has expired.
    let again = attacker.lease().await;
    assert_ne!(again.id, lease);
    let logged = line(&learner, &format!("at slot 0 (lease {lease})"));
    let who = format!("WARN actor {actor} (attacker) got nothing done for ");
    contains(&logged, &[&who, "the lease ends, its work is free again"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn refused_messages_are_logged_and_their_actor_is_quarantined() {
    let runs = Runs::new();
    let learner = learner(&runs.folder("run"), &[]);
    let mut attacker = Attacker::connect(&learner.url).await;
    for _ in 0..3 {
        let lease = attacker.lease().await;
        let pushed = message(&lease, &arbitrary_chunk(&attacker.run), &attacker.run);
        attacker.push(pushed).await;
        let what = format!("(lease {}) after 0 chunks", lease.id);
        let logged = line(&learner, &what);
        let who = format!("actor {} (attacker) was at slot 0", attacker.own.actor);
        contains(
            &logged,
            &["push_trajectory from 127.0.0.1:", "is refused", &who, "the lease ends"],
        );
        contains(&logged, &["CANARY_MISMATCH", "chunk.agents[0].log_prob"]);
    }
    let logged = line(&learner, "is in quarantine");
    let who = format!("WARN actor {} (attacker)", attacker.own.actor);
    contains(&logged, &[&who, "it gets no work for 20.0 s"]);
}
