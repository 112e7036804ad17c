//! Prints docs/FIDELITY.md's tables: `cargo run --release -p sim --example fidelity`.

mod compare;

use compare::{Difference, ROBOTS, Traces};

/// Ways to drive robots on the ground.
const GROUND: [&str; 3] = ["passive", "tenth", "full"];

fn main() {
    let traces = Traces::read();
    println!("Reference: {}.\n", traces.source());
    flight(&traces);
    ground(&traces);
}

fn flight(traces: &Traces) {
    println!(
        "In free flight, largest difference of any coordinate (m or rad) from the exact motion:\n"
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
    println!(
        "On the ground, mean difference; beside it MuJoCo's own from itself at a quarter of its step:\n"
    );
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

fn heads(traces: &Traces, what: &str) -> String {
    let head = |time: &f64| format!("{what} {time} s").trim().to_owned();
    traces.times_secs().iter().map(head).collect::<Vec<_>>().join(" | ")
}

fn cells(row: &[Difference], part: fn(&Difference) -> f64) -> String {
    row.iter().map(|d| format!("{:.4}", part(d))).collect::<Vec<_>>().join(" | ")
}
