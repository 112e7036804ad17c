//! The token of a run, which a learner requires in the headers of calls.

use std::path::PathBuf;

use proto::AUTHORIZATION;
use security::Token;
use tonic::Status;
use tonic::metadata::MetadataMap;

/// A token that a learner requires, and the file that contains it.
#[derive(Clone, Debug)]
pub(crate) struct RequiredToken {
    pub(crate) token: Token,
    pub(crate) file: PathBuf,
}

impl RequiredToken {
    /// Rejects a call without the token.
    pub(crate) fn demand(&self, headers: &MetadataMap) -> Result<(), Status> {
        let header = headers.get(AUTHORIZATION);
        if header.is_some_and(|header| self.token.is_in(header.as_bytes())) {
            return Ok(());
        }
        let presented = if header.is_some() { "another token" } else { "no token" };
        let variable = Token::VARIABLE;
        let file = self.file.display();
        Err(Status::unauthenticated(format!(
            "the call has {presented}, but needs the run's: set {variable} to the contents of {file}, which only \
             its owner can read"
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(required: &RequiredToken, sent: Option<&Token>) -> Result<(), String> {
        let mut headers = MetadataMap::new();
        sent.map(|token| headers.insert(AUTHORIZATION, token.header().parse().unwrap()));
        required.demand(&headers).map_err(|status| status.message().to_owned())
    }

    #[test]
    fn a_call_without_the_token_is_refused_with_the_name_of_its_file() {
        let (token, other) = (Token::random().unwrap(), Token::random().unwrap());
        let required = RequiredToken { token: token.clone(), file: "runs/a/token".into() };
        assert_eq!(answer(&required, Some(&token)), Ok(()));
        let line = answer(&required, None).unwrap_err();
        assert!(line.contains("no token") && line.contains("runs/a/token"), "{line}");
        let line = answer(&required, Some(&other)).unwrap_err();
        assert!(line.contains("another token") && !line.contains(token.text()), "{line}");
    }
}
