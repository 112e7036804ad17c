//! The header `authorization`, which carries the token of a run.

use tonic::metadata::AsciiMetadataValue;
use tonic::service::Interceptor;
use tonic::{Request, Status};

/// Name of the header.
pub const AUTHORIZATION: &str = "authorization";

/// Adds the header, if there is one, to each call of a client.
#[derive(Clone, Debug)]
pub struct Authorization(Option<AsciiMetadataValue>);

impl Authorization {
    /// Sends `header`, such as `Bearer TOKEN`.
    ///
    /// # Panics
    /// The header has other characters than printable ASCII; those of tokens are hexadecimal digits.
    #[must_use]
    pub fn new(header: Option<&str>) -> Self {
        Self(header.map(|header| {
            let mut value: AsciiMetadataValue = header.parse().expect("printable ASCII");
            value.set_sensitive(true);
            value
        }))
    }
}

impl Interceptor for Authorization {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request.metadata_mut().insert(AUTHORIZATION, value.clone());
        }
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_sent_if_there_is_one_and_never_printed() {
        let mut with = Authorization::new(Some("Bearer secret"));
        let request = with.call(Request::new(())).unwrap();
        assert_eq!(request.metadata().get(AUTHORIZATION).unwrap(), "Bearer secret");
        assert!(!format!("{with:?} {request:?}").contains("secret"));
        let without = Authorization::new(None).call(Request::new(())).unwrap();
        assert!(without.metadata().is_empty());
    }
}
