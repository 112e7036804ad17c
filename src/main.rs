//! The program `s2mia`: sets the allocator and runs the command line.

use std::process::ExitCode;

// The learner is slower with the system's allocator.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    s2mia::program()
}
