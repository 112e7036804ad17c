//! When the certificates of the clients that are connected expire.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rustls::pki_types::CertificateDer;

use crate::validity::Validity;

/// Numbers of connections by the moment at which the client's certificate expires, in seconds since 1970.
#[derive(Debug, Default)]
pub(crate) struct Expiries(Mutex<BTreeMap<i64, usize>>);

/// The certificate of one connection; dropping it ends the connection's count.
#[derive(Debug)]
pub struct ClientExpiry {
    at: i64,
    of: Arc<Expiries>,
}

impl Expiries {
    /// Counts a connection whose client presented this chain, its own certificate first.
    pub(crate) fn count(
        self: &Arc<Self>,
        chain: Option<&[CertificateDer<'_>]>,
    ) -> Option<ClientExpiry> {
        let at = Validity::of(chain?.first()?)?.until.unix_secs()?;
        *self.counts().entry(at).or_default() += 1;
        Some(ClientExpiry { at, of: Arc::clone(self) })
    }

    /// The earliest moment of all open connections, in seconds since 1970.
    pub(crate) fn earliest(&self) -> Option<i64> {
        self.counts().keys().next().copied()
    }

    fn counts(&self) -> MutexGuard<'_, BTreeMap<i64, usize>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for ClientExpiry {
    fn drop(&mut self) {
        let mut counts = self.of.counts();
        if let Some(count) = counts.get_mut(&self.at) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.at);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use rustls::pki_types::pem::PemObject as _;

    use super::*;
    use crate::development::Issuer;
    use crate::role::Role;

    #[test]
    fn the_earliest_end_of_all_open_connections_is_known_until_they_close() {
        let begin = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000_000);
        let chain = |secs| {
            let issuer = Issuer::new(begin, Duration::from_secs(secs)).unwrap();
            let issued = issuer.client(Role::Actor).unwrap();
            vec![CertificateDer::from_pem_slice(issued.certificate.as_bytes()).unwrap()]
        };
        let expiries = Arc::new(Expiries::default());
        assert!(expiries.count(None).is_none());
        let late = expiries.count(Some(&chain(900)));
        let early = [expiries.count(Some(&chain(60))), expiries.count(Some(&chain(60)))];
        assert_eq!(expiries.earliest(), Some(1_000_000_060));
        drop(early);
        assert_eq!(expiries.earliest(), Some(1_000_000_900));
        drop(late);
        assert_eq!(expiries.earliest(), None);
    }
}
