//! Compiles the `.proto` files without an installed protoc and writes their descriptors for reflection.

use std::error::Error;
use std::path::PathBuf;

use prost::Message;

const ROOT: &str = "proto";
/// Served by learners and policy servers, with reflection.
const SERVED: [&str; 6] = ["control", "learner", "policy", "environment", "trajectory", "tensor"];
/// Served by environment programs.
const OFFERED: &str = "proto/s2mia/v1/environment_service.proto";
/// Messages of trajectory logs.
const LOG: &str = "proto/s2mia/log/v1/log.proto";

fn main() -> Result<(), Box<dyn Error>> {
    let mut files = SERVED.map(|name| format!("{ROOT}/s2mia/v1/{name}.proto")).to_vec();
    println!("cargo::rerun-if-changed={ROOT}");
    let descriptors = protox::compile(&files, [ROOT])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("s2mia_descriptors.bin"), descriptors.encode_to_vec())?;
    files.push(OFFERED.to_owned());
    // Payloads stay slices of the received message instead of copies.
    tonic_prost_build::configure().bytes(".").compile_fds(protox::compile(&files, [ROOT])?)?;
    let log = protox::compile([LOG], [ROOT])?;
    std::fs::write(out.join("s2mia_log_descriptors.bin"), log.encode_to_vec())?;
    tonic_prost_build::configure().compile_fds(log)?;
    Ok(())
}
