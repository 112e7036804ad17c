//! The messages of a trajectory log, package `s2mia.log.v1`, for other programs. Never sent between actor and learner.
#![allow(
    missing_docs,
    unreachable_pub,
    clippy::allow_attributes_without_reason,
    reason = "generated; the documentation is in the .proto file"
)]

tonic::include_proto!("s2mia.log.v1");

/// The `.proto` file as an encoded `FileDescriptorSet`: the schema in every log.
pub const DESCRIPTORS: &[u8] =
    include_bytes!(concat!(env!("OUT_DIR"), "/s2mia_log_descriptors.bin"));
