//! Speed of s2mia on this machine. `cargo bench -p s2mia [-- SECTION ...] [--quick] [--json]` measures the named
//! sections, or all, and prints one Markdown table each, or JSON.
//! docs/PERFORMANCE.md explains the figures.

mod clock;
mod end_to_end;
mod inference;
mod iteration;
mod load;
mod off_policy;
mod peak;
mod processes;
mod run_in_process;
mod scaling;
mod settings;
mod shapes;
mod sizing;
mod synthetic;
mod table;
mod update;
mod wire;

use anyhow::{bail, ensure};

use crate::table::{CaseRow, Section};

// The allocator of the program, so that the figures are comparable.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Numbers of repetitions.
#[derive(Clone, Copy)]
pub(crate) struct Effort {
    /// Repetitions of short measurements.
    repeats: usize,
    /// Measured iterations of a run, after two unmeasured ones.
    iterations: usize,
    /// Numbers of actors in the load test.
    actors: &'static [usize],
}

const FULL: Effort = Effort { repeats: 5, iterations: 4, actors: &[1, 4, 16, 64, 256, 1000] };
const QUICK: Effort = Effort { repeats: 1, iterations: 1, actors: &[1, 16] };

/// Name of a section, description of its rows, and the function that measures them.
type Measurement = (&'static str, &'static str, fn(Effort) -> anyhow::Result<Vec<CaseRow>>);

const SECTIONS: [Measurement; 11] = [
    ("inference", "one step of a slot: all its agents in all its environments", inference::rows),
    ("shapes", "the updates below; those of `update` with preset `harl`", shapes::rows),
    ("update", "one update; its parts on one thread", update::rows),
    (
        "off-policy",
        "one update with the default settings, after 10 environments x 50 steps",
        off_policy::rows,
    ),
    ("peak", "matrix products of an update on one thread, and of a core at its best", peak::rows),
    ("end-to-end", "`s2mia train` with 2 actors, preset `harl`", end_to_end::rows),
    ("wire", "one iteration of `halfcheetah-6x1` with 2 actors, medians", wire::rows),
    ("traffic", "bytes that a slot sends and an actor fetches", wire::traffic),
    (
        "sizing",
        "one iteration's cost for actors and learner; for equal halves, their ratio",
        sizing::rows,
    ),
    ("load", "a learner process and N actors that send a recorded slot", load::rows),
    ("scaling", "one update of a synthetic task, on two threads", scaling::rows),
];

fn main() -> anyhow::Result<()> {
    choose_registers()?;
    let (options, wanted): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|argument| argument.starts_with("--"));
    // `cargo bench` passes --bench. `cargo test` does not; then only settings and shapes are checked.
    let strange = options.iter().find(|o| !["--bench", "--quick", "--json"].contains(&o.as_str()));
    if let Some(strange) = strange {
        bail!("unknown option {strange}; known are --quick and --json");
    }
    let names: Vec<&str> = SECTIONS.iter().map(|(name, ..)| *name).collect();
    if let Some(strange) = wanted.iter().find(|name| !names.contains(&name.as_str())) {
        bail!("unknown section {strange}; known are {}", names.join(", "));
    }
    let given = |option: &str| options.iter().any(|found| found == option);
    let wanted = if given("--bench") { wanted } else { vec!["shapes".to_owned()] };
    let effort = if given("--quick") { QUICK } else { FULL };
    let mut sections = Vec::new();
    for (name, caption, measure) in SECTIONS {
        if !wanted.is_empty() && !wanted.iter().any(|wanted| wanted == name) {
            continue;
        }
        let section = Section { name, caption, rows: measure(effort)? };
        if !given("--json") {
            println!("{}", section.to_markdown());
        }
        sections.push(section);
    }
    if given("--json") {
        println!("{}", table::to_json(&sections));
    }
    Ok(())
}

/// Selects the SIMD width by `S2MIA_SIMD`, as in the program.
fn choose_registers() -> anyhow::Result<()> {
    let Ok(name) = std::env::var("S2MIA_SIMD") else { return Ok(()) };
    ensure!(
        kernels::Width::named(&name).is_some_and(kernels::select),
        "S2MIA_SIMD is {name}, which is not available"
    );
    Ok(())
}
