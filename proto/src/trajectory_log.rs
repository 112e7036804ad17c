//! The messages of a trajectory log, package `s2mia.log.v1`: what an actor writes for people and programs outside.
//! Nothing of it travels between actor and learner.
#![allow(
    missing_docs,
    unreachable_pub,
    clippy::allow_attributes_without_reason,
    reason = "generated; the .proto file holds the documentation"
)]

tonic::include_proto!("s2mia.log.v1");

/// The `.proto` file as an encoded `FileDescriptorSet`: the schema that stands in every log.
pub const DESCRIPTORS: &[u8] =
    include_bytes!(concat!(env!("OUT_DIR"), "/s2mia_log_descriptors.bin"));
