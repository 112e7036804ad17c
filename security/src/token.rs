//! The token of a run: a random secret that permits calls over plain text on one machine.

use std::fmt::{self, Write as _};

use rustls::crypto::ring;
use subtle::ConstantTimeEq as _;

use crate::error::SecurityError;

/// Random bytes in a token.
const BYTES: usize = 32;
/// Scheme of the header `authorization` (RFC 6750).
const SCHEME: &str = "Bearer ";

/// A token, as 64 hexadecimal digits. `Debug` does not print it.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Environment variable from which clients take the token.
    pub const VARIABLE: &str = "S2MIA_TOKEN";

    /// A new token from the operating system's randomness.
    ///
    /// # Errors
    /// The operating system provides no randomness.
    pub fn random() -> Result<Self, SecurityError> {
        let mut bytes = [0; BYTES];
        let filled = ring::default_provider().secure_random.fill(&mut bytes);
        filled.map_err(|_| {
            let why = "the operating system provides no randomness for the run's token";
            SecurityError(why.to_owned())
        })?;
        let digits = bytes.iter().fold(String::new(), |mut digits, byte| {
            // Writing to a string cannot fail.
            let _written = write!(digits, "{byte:02x}");
            digits
        });
        Ok(Self(digits))
    }

    /// The token in `text`, such as the contents of its file; refuses text that is no token.
    ///
    /// # Errors
    /// `text` is not 64 hexadecimal digits.
    pub fn parse(text: &str) -> Result<Self, SecurityError> {
        let digits = text.trim();
        let valid =
            digits.len() == 2 * BYTES && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
        if valid {
            return Ok(Self(digits.to_owned()));
        }
        let form = "a token has 64 hexadecimal digits; copy it from the file `token` of the run folder, or make one for a learner with \
             `openssl rand -hex 32`";
        Err(SecurityError(form.to_owned()))
    }

    /// The token as text, for its file and for an actor's environment.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Value of the header `authorization` that carries the token.
    #[must_use]
    pub fn header(&self) -> String {
        format!("{SCHEME}{}", self.0)
    }

    /// Whether a header `authorization` carries this token; takes the same time for every wrong token of its length.
    #[must_use]
    pub fn is_in(&self, header: &[u8]) -> bool {
        let presented = header.strip_prefix(SCHEME.as_bytes());
        presented.is_some_and(|presented| bool::from(presented.ct_eq(self.0.as_bytes())))
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Token")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_header_with_the_whole_token_carries_it() {
        let (token, other) = (Token::random().unwrap(), Token::random().unwrap());
        assert!(token.is_in(token.header().as_bytes()));
        let part = &token.header()[..SCHEME.len() + 10];
        for wrong in [other.header().as_str(), part, SCHEME, "", token.text()] {
            assert!(!token.is_in(wrong.as_bytes()), "{wrong}");
        }
    }

    #[test]
    fn a_token_survives_its_file_and_other_text_is_refused() {
        let token = Token::random().unwrap();
        assert_eq!(Token::parse(&format!("{}\n", token.text())).unwrap().text(), token.text());
        for wrong in ["", "abc", &"g".repeat(64), &"a".repeat(63)] {
            assert!(Token::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn debug_output_does_not_contain_the_token() {
        assert_eq!(format!("{:?}", Token::random().unwrap()), "Token");
    }
}
