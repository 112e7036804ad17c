//! Prints the tables of docs/FIDELITY.md: `cargo run --release -p sim --example fidelity`. With a folder and the path of a
//! model in it, prints where the robot falls in a quarter of a second.

mod compare;
mod fall;
mod held_out;
mod random;

use compare::{Difference, ROBOTS, Traces};
use held_out::{DRIVES, Errors, HeldOut};
use random::Statistics;

/// Controls for the robots on the ground.
const GROUND: [&str; 3] = ["passive", "tenth", "full"];

/// Name of a row and its quantity.
type Row<T> = (&'static str, fn(&T) -> f64);

fn main() {
    if let [folder, document] = &*std::env::args().skip(1).collect::<Vec<_>>() {
        println!("{}", fall::report(folder, document));
    } else {
        tables();
    }
}

fn tables() {
    let traces = Traces::read();
    println!("Reference: {}.\n", traces.source());
    flight(&traces);
    ground(&traces);
    let held_out = HeldOut::read();
    println!("\nReference: {}.\n", held_out.source());
    other_controls(&held_out);
    at_random(&held_out);
}

fn flight(traces: &Traces) {
    println!(
        "Free flight, largest difference of any coordinate (m or rad) from the exact motion:\n"
    );
    println!("| robot | steps | {} |", heads(traces, ""));
    println!("| --- | --- |{}", " --- |".repeat(traces.times_secs().len()));
    for robot in ROBOTS {
        for (parts, words) in [(1, "the task's"), (32, "32 times shorter")] {
            let row = traces.flight(robot, parts);
            println!("| {} | {words} | {} |", robot.0, cells(&row, |d| d.largest));
        }
    }
    println!();
}

fn ground(traces: &Traces) {
    println!("On the ground, mean difference:\n");
    let times = traces.times_secs().len();
    println!(
        "| robot | torque | who | {} | {} |",
        heads(traces, "x, m,"),
        heads(traces, "hinge, rad,")
    );
    println!("| --- | --- | --- |{}", " --- |".repeat(2 * times));
    for robot in ROBOTS {
        for drive in GROUND {
            for (who, row) in ["ours", "MuJoCo"].into_iter().zip(traces.ground(robot, drive)) {
                let (places, angles) = (cells(&row, |d| d.place), cells(&row, |d| d.angle));
                println!("| {} | {drive} | {who} | {places} | {angles} |", robot.0);
            }
        }
    }
}

/// Prints one cell per robot and drive: difference from MuJoCo / of MuJoCo from itself at a quarter of its step.
fn other_controls(held_out: &HeldOut) {
    println!(
        "Other controls and starts, mean difference (x in m; hinge in rad), ours / MuJoCo's own:\n"
    );
    println!("| | {} |", ROBOTS.map(|(name, _)| name).join(" | "));
    println!("| --- |{}", " --- |".repeat(ROBOTS.len()));
    let mut all: Vec<[Vec<Errors>; 2]> = vec![Default::default(); ROBOTS.len()];
    for (drive, words) in DRIVES {
        let cells = ROBOTS.iter().zip(&mut all).map(|(robot, all)| {
            let [ours, own] = held_out.errors(*robot, drive);
            all[0].push(ours);
            all[1].push(own);
            let [x, angle] = [|e: &Errors| e.place, |e: &Errors| e.angle];
            format!("{}; {}", pair([&ours, &own], x), pair([&ours, &own], angle))
        });
        println!("| {words} | {} |", cells.collect::<Vec<_>>().join(" | "));
    }
    let parts: [Row<Errors>; 4] = [
        ("all: x, m", |e| e.place),
        ("all: z, m", |e| e.height),
        ("all: pitch, rad", |e| e.pitch),
        ("all: hinge, rad", |e| e.angle),
    ];
    for (words, part) in parts {
        let cells =
            all.iter().map(|[ours, own]| pair([&held_out::mean(ours), &held_out::mean(own)], part));
        println!("| {words} | {} |", cells.collect::<Vec<_>>().join(" | "));
    }
    println!();
}

fn pair([ours, own]: [&Errors; 2], part: fn(&Errors) -> f64) -> String {
    format!("{:.4} / {:.4}", part(ours), part(own))
}

fn at_random(held_out: &HeldOut) {
    println!("Uniform random actions from the same starts, MuJoCo -> ours:\n");
    println!("| | {} |", ROBOTS.map(|(name, _)| name).join(" | "));
    println!("| --- |{}", " --- |".repeat(ROBOTS.len()));
    let rows: [Row<Statistics>; 5] = [
        ("height, m", |s| s.height),
        ("contact fraction", |s| s.contact),
        ("limit overshoot p99.9, rad", |s| s.overshoot),
        ("mean joint speed, rad/s", |s| s.joint_speed),
        ("episode length", |s| s.length),
    ];
    let both = ROBOTS.map(|robot| {
        let record = held_out.random(robot.0);
        [Statistics::recorded(record), random::play(robot, record)]
    });
    for (words, part) in rows {
        let cells =
            both.iter().map(|[theirs, ours]| format!("{:.3} -> {:.3}", part(theirs), part(ours)));
        println!("| {words} | {} |", cells.collect::<Vec<_>>().join(" | "));
    }
}

fn heads(traces: &Traces, what: &str) -> String {
    let head = |time: &f64| format!("{what} {time} s").trim().to_owned();
    traces.times_secs().iter().map(head).collect::<Vec<_>>().join(" | ")
}

fn cells(row: &[Difference], part: fn(&Difference) -> f64) -> String {
    row.iter().map(|d| format!("{:.4}", part(d))).collect::<Vec<_>>().join(" | ")
}
