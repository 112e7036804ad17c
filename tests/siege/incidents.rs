//! Each lost, late or quarantined actor is one line of the log: the actor, its work, and the consequence.

use std::time::{Duration, Instant};

use crate::attackers::{Attacker, invented, message};
use crate::learners::Learner;

/// The line that holds `words`, as soon as there is one.
async fn line(learner: &Learner, words: &str) -> String {
    let patience = Instant::now() + Duration::from_secs(30);
    loop {
        let log = learner.log();
        let mut found = log.lines().filter(|line| line.contains(words));
        if let Some(line) = found.next() {
            assert_eq!(found.next(), None, "told twice");
            return line.to_owned();
        }
        assert!(Instant::now() < patience, "no line with `{words}` in:\n{log}");
        tokio::task::yield_now().await;
    }
}

fn holds(line: &str, all: &[&str]) {
    assert!(all.iter().all(|words| line.contains(words)), "{all:?}: {line}");
}

async fn ends(mut learner: Learner) {
    tokio::task::spawn_blocking(move || learner.stop()).await.unwrap();
}

#[tokio::test]
async fn an_actor_that_is_lost_in_the_middle_of_a_slot_is_named_with_the_slot() {
    let folder = tempfile::tempdir().unwrap();
    let learner = Learner::start(&folder.path().join("run"), &[]);
    let mut attacker = Attacker::connect(&learner.url).await;
    let (actor, lease) = (attacker.own.actor, attacker.lease().await.id);
    drop(attacker);
    let told = line(&learner, " is gone, at ").await;
    let who = format!("WARN actor {actor} (attacker) is gone");
    let what = format!("at slot 0 (lease {lease}) after 0 chunks");
    holds(&told, &[&who, &what, "its work is free again"]);
    ends(learner).await;
}

#[tokio::test]
async fn a_lease_of_which_nothing_is_heard_is_told_when_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let short = ["lease.ttl_secs=0.4", "lease.heartbeat_secs=0.1"].map(str::to_owned);
    let learner = Learner::start(&folder.path().join("run"), &short);
    let mut attacker = Attacker::connect(&learner.url).await;
    let (actor, lease) = (attacker.own.actor, attacker.lease().await.id);
    let _other_slot = attacker.lease().await;
    // Nothing is free until the first lease has ended.
    let again = attacker.lease().await;
    assert_ne!(again.id, lease);
    let told = line(&learner, &format!("at slot 0 (lease {lease})")).await;
    let who = format!("WARN actor {actor} (attacker) got nothing done for ");
    holds(&told, &[&who, "the lease ends, its work is free again"]);
    ends(learner).await;
}

#[tokio::test]
async fn an_actor_whose_messages_are_refused_is_told_each_time_and_then_put_in_quarantine() {
    let folder = tempfile::tempdir().unwrap();
    let learner = Learner::start(&folder.path().join("run"), &[]);
    let mut attacker = Attacker::connect(&learner.url).await;
    for _ in 0..3 {
        let lease = attacker.lease().await;
        let pushed = message(&lease, &invented(&attacker.run), &attacker.run);
        attacker.push(pushed).await;
        let what = format!("(lease {}) after 0 chunks", lease.id);
        let told = line(&learner, &what).await;
        let who = format!("actor {} (attacker) was at slot 0", attacker.own.actor);
        holds(&told, &["push_trajectory from 127.0.0.1:", "is refused", &who, "the lease ends"]);
        holds(&told, &["CANARY_MISMATCH", "chunk.agents[0].log_prob"]);
    }
    let told = line(&learner, "is in quarantine").await;
    let who = format!("WARN actor {} (attacker)", attacker.own.actor);
    holds(&told, &[&who, "it gets no work for 20.0 s"]);
    ends(learner).await;
}
