//! The token of a run in the headers of its calls: what a learner requires, and what a client sends.

use std::path::PathBuf;

use proto::{AUTHORIZATION, Authorization};
use security::{Role, Token};
use tonic::Status;
use tonic::metadata::MetadataMap;

/// A token that a learner requires, and the file that contains it.
#[derive(Clone, Debug)]
pub(crate) struct RequiredToken {
    pub(crate) token: Token,
    pub(crate) file: PathBuf,
}

impl RequiredToken {
    /// Rejects a call without the token. Calls of viewers need none: they read what the page shows without one.
    pub(crate) fn demand(&self, headers: &MetadataMap, role: Role) -> Result<(), Status> {
        let header = headers.get(AUTHORIZATION);
        if role == Role::Viewer || header.is_some_and(|header| self.token.is_in(header.as_bytes()))
        {
            return Ok(());
        }
        let presented = if header.is_some() { "another token" } else { "no token" };
        let (variable, file) = (Token::VARIABLE, self.file.display());
        Err(Status::unauthenticated(format!(
            "the call has {presented}, but needs the run's: set {variable} to the contents of {file}, which only \
             its owner can read"
        )))
    }
}

/// The header with `token` for each call of a client.
pub(crate) fn authorization(token: Option<&Token>) -> Authorization {
    let header = token.map(Token::header);
    Authorization::new(header.as_deref()).expect("hexadecimal digits are valid in a header")
}

#[cfg(test)]
mod tests {
    use tonic::Request;
    use tonic::service::Interceptor as _;

    use super::*;

    fn answer(required: &RequiredToken, sent: Option<&Token>, role: Role) -> Result<(), String> {
        let request = authorization(sent).call(Request::new(())).unwrap();
        let answer = required.demand(request.metadata(), role);
        answer.map_err(|status| status.message().to_owned())
    }

    #[test]
    fn calls_of_actors_and_admins_need_the_token_and_those_of_viewers_do_not() {
        let (token, other) = (Token::random().unwrap(), Token::random().unwrap());
        let required = RequiredToken { token: token.clone(), file: "runs/a/token".into() };
        for role in [Role::Actor, Role::Admin] {
            assert_eq!(answer(&required, Some(&token), role), Ok(()));
            let line = answer(&required, None, role).unwrap_err();
            assert!(line.contains("no token") && line.contains("runs/a/token"), "{line}");
            let line = answer(&required, Some(&other), role).unwrap_err();
            assert!(line.contains("another token") && !line.contains(token.text()), "{line}");
        }
        assert_eq!(answer(&required, None, Role::Viewer), Ok(()));
    }
}
