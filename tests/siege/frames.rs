//! HTTP/2 by hand (RFC 9113), for clients that stop where no library would.

/// How a client begins: the preface, and settings, here none of them.
pub(crate) const BEGINNING: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

const DATA: u8 = 0;
const HEADERS: u8 = 1;
const END_HEADERS: u8 = 4;

fn frame(kind: u8, flags: u8, content: &[u8]) -> Vec<u8> {
    let length = u32::try_from(content.len()).unwrap().to_be_bytes();
    [&length[1..], &[kind, flags, 0, 0, 0, 1], content].concat()
}

/// The headers of a call of `PushTrajectory`, none of them compressed (RFC 7541, section 6.2.2).
fn call() -> Vec<u8> {
    // POST and http stand in the static table; the other names are spelt out.
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

/// A beginning, and the first half of the headers of a call.
pub(crate) fn half_a_header_block() -> Vec<u8> {
    let block = call();
    [BEGINNING, &frame(HEADERS, 0, &block[..block.len() / 2])].concat()
}

/// A call, and of its message only the length, the largest that is allowed, and three bytes.
pub(crate) fn half_a_message() -> Vec<u8> {
    let length = u32::try_from(proto::MAX_MESSAGE_BYTES).unwrap().to_be_bytes();
    let begun = [&[0], length.as_slice(), &[1, 2, 3]].concat();
    [BEGINNING, &frame(HEADERS, END_HEADERS, &call()), &frame(DATA, 0, &begun)].concat()
}
