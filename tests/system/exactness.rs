//! With any number of actors and threads, and with killed, frozen or stopped processes,
//! a run ends with the same weights, optimiser and densities, bit for bit.
//!
//! `cargo test` runs `CELLS`, which contain every pair of values of two columns. All combinations are run and printed
//! as a table by `EXACTNESS_MATRIX=whole cargo test --test system exactness -- --nocapture`.

use std::path::Path;
use std::time::Duration;

use crate::processes::{Background, children, has_begun, signal};
use crate::runs::{Runs, SMALL_HASAC, SMALL_MADDPG, inspect, succeeded, text, tiny, train};

/// A disturbance of a run of six iterations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Disturbance {
    Nothing,
    /// An actor is killed while it steps.
    ActorKilled,
    /// An actor is frozen until its lease has expired, then continues.
    ActorFrozen,
    /// The learner is killed at this point, and the run is resumed.
    LearnerDies(&'static str),
    /// The run is stopped after three iterations and resumed.
    Stopped,
}

use Disturbance::{ActorFrozen, ActorKilled, LearnerDies, Nothing, Stopped};

/// Disturbances in the order of the table; the learner is killed at a different iteration in each.
const DISTURBANCES: [Disturbance; 8] = [
    Nothing,
    ActorKilled,
    ActorFrozen,
    LearnerDies("after-collect@3"),
    LearnerDies("mid-update@2"),
    LearnerDies("after-publish@4"),
    LearnerDies("mid-checkpoint@2"),
    Stopped,
];
const ACTORS: [u32; 3] = [1, 2, 4];
const THREADS: [u32; 2] = [1, 2];
const RULES: [Rule; 4] = [OnPolicy, Recurrent, Replay, SoftReplay];

/// The learning rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rule {
    /// HAPPO-S2MIA.
    OnPolicy,
    /// HAPPO-S2MIA with a recurrent critic, whose memory is part of the state.
    Recurrent,
    /// MADDPG, whose state includes the replay.
    Replay,
    /// HASAC, whose state also includes running statistics and temperatures.
    SoftReplay,
}

use Rule::{OnPolicy, Recurrent, Replay, SoftReplay};

impl Rule {
    /// Settings of the rule.
    fn settings(self) -> &'static [&'static str] {
        match self {
            OnPolicy => &[],
            Recurrent => &["critic.core=gru"],
            Replay => &SMALL_MADDPG,
            SoftReplay => &SMALL_HASAC,
        }
    }
}

type Cell = (Rule, Disturbance, u32, u32);

/// Rule, disturbance, actors, threads: every disturbance with every rule, with actors and threads rotated to cover all
/// pairs.
const CELLS: [Cell; 32] = {
    let mut cells = [(OnPolicy, Nothing, 0, 0); 32];
    let mut index = 0;
    while index < 32 {
        let (disturbance, rule) = (index / 4, index % 4);
        let place = disturbance + rule;
        cells[index] =
            (RULES[rule], DISTURBANCES[disturbance], ACTORS[place % 3], THREADS[place % 2]);
        index += 1;
    }
    cells
};

fn every_combination() -> Vec<Cell> {
    let mut cells = Vec::new();
    for rule in RULES {
        for disturbance in DISTURBANCES {
            let pairs = ACTORS.iter().flat_map(|actors| THREADS.map(|threads| (*actors, threads)));
            cells.extend(pairs.map(|(actors, threads)| (rule, disturbance, actors, threads)));
        }
    }
    cells
}

const SIX: &str = "run.iterations=6";

fn play(folder: &Path, (rule, disturbance, count, threads): Cell) {
    let (actors, threads) = (format!("run.actors={count}"), format!("learner.threads={threads}"));
    let machine = [actors.as_str(), threads.as_str()];
    let settings = [rule.settings(), &machine, &[SIX]].concat();
    let resume = || {
        let again = ["train", "--resume", text(folder), SIX];
        succeeded(&[&again[..], &machine].concat());
    };
    // Disturbs an actor of a run that has begun, and waits for the end of the run.
    let disturbed = |more: &[&str], disturb: fn(u32)| {
        let mut run = tiny("train", folder, &[&settings[..], more].concat());
        let mut run = Background::start(&mut run);
        has_begun(folder);
        disturb(children(run.process.id(), count as usize)[0]);
        run.rest();
        run.log()
    };
    match disturbance {
        Nothing => drop(train(folder, &settings)),
        ActorKilled => {
            let log = disturbed(&[], |actor| signal(actor, "-KILL"));
            // With other actors, the run may end before another one is started.
            assert!(count > 1 || log.contains("starting another in its place"), "{log}");
        }
        ActorFrozen => drop(disturbed(&["lease.ttl_secs=0.4"], |actor| {
            signal(actor, "-STOP");
            // Until the lease has expired: with other actors the run continues meanwhile, with one it waits.
            std::thread::sleep(Duration::from_millis(800));
            signal(actor, "-CONT");
        })),
        LearnerDies(point) => {
            let mut run = tiny("train", folder, &settings);
            let ended = run.env("S2MIA_FAIL_AT", point).output().unwrap();
            assert!(!ended.status.success(), "{point} was never reached");
            resume();
        }
        Stopped => {
            train(folder, &[&settings[..], &["run.iterations=3"]].concat());
            resume();
        }
    }
}

/// Runs all cells and compares each with the first one of its rule.
fn compare(cells: &[Cell]) {
    let runs = Runs::new();
    let mut firsts: Vec<(Rule, serde_json::Value)> = Vec::new();
    println!("| rule | disturbance | actors | threads | state |");
    println!("| --- | --- | --- | --- | --- |");
    for (index, cell) in cells.iter().enumerate() {
        let folder = runs.folder(&index.to_string());
        play(&folder, *cell);
        let state = inspect(&folder);
        let (rule, disturbance, actors, threads) = cell;
        let hash = &state["state_sha256"].as_str().unwrap()[..16];
        println!("| {rule:?} | {disturbance:?} | {actors} | {threads} | `{hash}` |");
        assert_eq!(state["iteration"], 6);
        match firsts.iter().find(|(first, _)| first == rule) {
            Some((_, first)) => assert_eq!(&state, first, "{cell:?}"),
            None => firsts.push((*rule, state)),
        }
    }
}

#[test]
fn every_cell_ends_with_the_same_state_bit_for_bit() {
    match std::env::var("EXACTNESS_MATRIX").as_deref() {
        Ok("whole") => compare(&every_combination()),
        _ => compare(&CELLS),
    }
}

#[test]
fn every_pair_of_values_is_in_some_cell() {
    type Same = fn(&Cell, &Cell) -> bool;
    let columns: [Same; 4] =
        [|a, b| a.0 == b.0, |a, b| a.1 == b.1, |a, b| a.2 == b.2, |a, b| a.3 == b.3];
    for wanted in every_combination() {
        for (at, one) in columns.iter().enumerate() {
            for other in &columns[at + 1..] {
                let found = CELLS.iter().any(|cell| one(cell, &wanted) && other(cell, &wanted));
                assert!(found, "{wanted:?} shares no pair of two of its columns with any cell");
            }
        }
    }
}

/// Settings that the cells do not cover: other rules, networks and statistics, robots that fall, and a game.
const VARIANTS: [&[&str]; 8] = [
    &["algorithm=mappo", "policy.core=mlp", "policy.width=8", "policy.layers=1"],
    &["algorithm=mappo", "update.parameters=separate", "surprise.alpha=0.01"],
    &["algorithm=happo-s2mia", "policy.core=mlp", "policy.width=8", "policy.layers=1"],
    &["algorithm=happo-s2mia", "observation.norm=none"],
    &["algorithm=happo-s2mia-exact", "policy.noise_hold=3"],
    &["task=walker2d-2x3", "observation.mode=k_nearest"],
    &["task=ant-4x2", "observation.contact_forces=zeros"],
    &["task=cue-2x1"],
];

/// With [`SMALL_HASAC`]: surprise, and noise that agents share with learnt loadings.
const SOFT_VARIANT: [&str; 5] = [
    "task=walker2d-2x3",
    "algorithm=hasac-s2mia-exact",
    "hasac.warm_up=80",
    "policy.noise_hold=3",
    "policy.noise_decay_steps=900",
];

#[test]
fn every_variant_ends_with_the_same_state_with_any_number_of_actors_and_slots_and_through_a_stop() {
    let runs = Runs::new();
    let soft = [&SMALL_HASAC[..], &SOFT_VARIANT].concat();
    for (index, variant) in VARIANTS.into_iter().chain([&soft[..]]).enumerate() {
        let [whole, parts] = ["whole", "parts"].map(|name| runs.folder(&format!("{index}-{name}")));
        let small = ["run.iterations=4", "run.actors=2", "environments.per_slot=1"];
        train(&whole, &[variant, &small].concat());
        let large = ["run.iterations=2", "run.actors=1", "environments.per_slot=4"];
        train(&parts, &[variant, &large].concat());
        succeeded(&["train", "--resume", text(&parts), "run.iterations=4"]);
        assert_eq!(inspect(&parts), inspect(&whole), "{variant:?}");
    }
}
