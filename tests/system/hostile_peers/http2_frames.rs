//! HTTP/2 frames encoded by hand (RFC 9113), for clients that stall in the middle of one.

/// The first bytes of a client: the preface and an empty SETTINGS frame.
pub(super) const FIRST_BYTES: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

const DATA: u8 = 0;
const HEADERS: u8 = 1;
const END_HEADERS: u8 = 4;

fn frame(kind: u8, flags: u8, content: &[u8]) -> Vec<u8> {
    let length = u32::try_from(content.len()).unwrap().to_be_bytes();
    [&length[1..], &[kind, flags, 0, 0, 0, 1], content].concat()
}

/// The uncompressed headers of a `PushTrajectory` call (RFC 7541, section 6.2.2).
fn call() -> Vec<u8> {
    // POST and http are entries of the static table; the other names are literals.
    let mut block = vec![0x83, 0x86];
    for (name, value) in [
        (":path", "/s2mia.v1.LearnerService/PushTrajectory"),
        (":authority", "learner"),
        ("content-type", "application/grpc"),
        ("te", "trailers"),
    ] {
        block.push(0);
        for text in [name, value] {
            block.push(u8::try_from(text.len()).unwrap());
            block.extend_from_slice(text.as_bytes());
        }
    }
    block
}

/// The first bytes and half of the headers of a call.
pub(super) fn half_a_header_block() -> Vec<u8> {
    let block = call();
    [FIRST_BYTES, &frame(HEADERS, 0, &block[..block.len() / 2])].concat()
}

/// A call whose message announces the largest allowed length but has three bytes.
pub(super) fn half_a_message() -> Vec<u8> {
    let length = u32::try_from(proto::MAX_MESSAGE_BYTES).unwrap().to_be_bytes();
    let begun = [&[0], length.as_slice(), &[1, 2, 3]].concat();
    [FIRST_BYTES, &frame(HEADERS, END_HEADERS, &call()), &frame(DATA, 0, &begun)].concat()
}
