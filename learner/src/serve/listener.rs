//! The listening socket and the authentication it requires.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use proto::AUTHORIZATION;
use security::{ServerTls, Token};
use tokio::net::TcpListener;
use tonic::Status;
use tonic::metadata::MetadataMap;

use crate::store::run_folder::RunFolder;

/// A listening socket.
#[derive(Debug)]
pub struct Listener {
    pub(crate) listener: TcpListener,
    /// With it, every peer needs a certificate. Without, all traffic is plain text.
    pub(crate) tls: Option<ServerTls>,
    /// Required of every call that changes the run.
    pub(crate) token: Option<Arc<RequiredToken>>,
}

impl Listener {
    /// A listener that requires a client certificate. The certificate's role determines the permitted calls.
    #[must_use]
    pub fn authenticated(listener: TcpListener, tls: ServerTls) -> Self {
        Self { listener, tls: Some(tls), token: None }
    }

    /// The same listener, which also requires `token`. The learner writes it to the run folder `folder`.
    #[must_use]
    pub fn with_token(self, token: Token, folder: &Path) -> Self {
        let file = RunFolder::token_file(folder);
        Self { token: Some(Arc::new(RequiredToken { token, file })), ..self }
    }
}

/// A listener without authentication: every peer may make every call.
impl From<TcpListener> for Listener {
    fn from(listener: TcpListener) -> Self {
        Self { listener, tls: None, token: None }
    }
}

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
