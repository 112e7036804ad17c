//! Each lost, late or quarantined actor is one line of the log: the actor, its work, and the consequence.

use std::time::{Duration, Instant};

use crate::attackers::{Attacker, arbitrary_chunk, message};
use crate::learners::Learner;

/// Waits for the only log line that contains `words`.
async fn line(learner: &Learner, words: &str) -> String {
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        let log = learner.log();
        let mut found = log.lines().filter(|line| line.contains(words));
        if let Some(line) = found.next() {
            assert_eq!(found.next(), None, "logged twice");
            return line.to_owned();
        }
        assert!(Instant::now() < deadline, "no line with `{words}` in:\n{log}");
        tokio::task::yield_now().await;
    }
}

fn contains(line: &str, all: &[&str]) {
    assert!(all.iter().all(|words| line.contains(words)), "{all:?}: {line}");
}

async fn ends(mut learner: Learner) {
    tokio::task::spawn_blocking(move || learner.stop()).await.unwrap();
}

#[tokio::test]
async fn an_actor_lost_during_a_slot_is_logged_with_the_slot() {
    let folder = tempfile::tempdir().unwrap();
    let learner = Learner::start(&folder.path().join("run"), &[]);
    let mut attacker = Attacker::connect(&learner.url).await;
    let (actor, lease) = (attacker.own.actor, attacker.lease().await.id);
    drop(attacker);
    let logged = line(&learner, " is gone, at ").await;
    let who = format!("WARN actor {actor} (attacker) is gone");
    let what = format!("at slot 0 (lease {lease}) after 0 chunks");
    contains(&logged, &[&who, &what, "its work is free again"]);
    ends(learner).await;
}

#[tokio::test]
async fn an_expired_lease_is_logged() {
    let folder = tempfile::tempdir().unwrap();
    let short = ["lease.ttl_secs=0.4".to_owned()];
    let learner = Learner::start(&folder.path().join("run"), &short);
    let mut attacker = Attacker::connect(&learner.url).await;
    let (actor, lease) = (attacker.own.actor, attacker.lease().await.id);
    let _other_slot = attacker.lease().await;
    // No slot is free until the first lease has expired.
    let again = attacker.lease().await;
    assert_ne!(again.id, lease);
    let logged = line(&learner, &format!("at slot 0 (lease {lease})")).await;
    let who = format!("WARN actor {actor} (attacker) got nothing done for ");
    contains(&logged, &[&who, "the lease ends, its work is free again"]);
    ends(learner).await;
}

#[tokio::test]
async fn refused_messages_are_logged_and_their_actor_is_quarantined() {
    let folder = tempfile::tempdir().unwrap();
    let learner = Learner::start(&folder.path().join("run"), &[]);
    let mut attacker = Attacker::connect(&learner.url).await;
    for _ in 0..3 {
        let lease = attacker.lease().await;
        let pushed = message(&lease, &arbitrary_chunk(&attacker.run), &attacker.run);
        attacker.push(pushed).await;
        let what = format!("(lease {}) after 0 chunks", lease.id);
        let logged = line(&learner, &what).await;
        let who = format!("actor {} (attacker) was at slot 0", attacker.own.actor);
        contains(
            &logged,
            &["push_trajectory from 127.0.0.1:", "is refused", &who, "the lease ends"],
        );
        contains(&logged, &["CANARY_MISMATCH", "chunk.agents[0].log_prob"]);
    }
    let logged = line(&learner, "is in quarantine").await;
    let who = format!("WARN actor {} (attacker)", attacker.own.actor);
    contains(&logged, &[&who, "it gets no work for 20.0 s"]);
    ends(learner).await;
}
