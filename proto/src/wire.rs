//! Generated messages, client and server of package `s2mia.v1`. Only conversions in this crate and
//! the files that face the network use them.
#![allow(
    missing_docs,
    unreachable_pub,
    clippy::allow_attributes_without_reason,
    clippy::large_enum_variant,
    clippy::too_many_lines,
    reason = "generated; the documentation is in the .proto files"
)]

tonic::include_proto!("s2mia.v1");

/// The `.proto` files as an encoded `FileDescriptorSet`, for reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/s2mia_descriptors.bin"));
