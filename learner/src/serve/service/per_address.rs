//! Limits the connections of each address.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Open connections of each address, at most `most`.
#[derive(Clone, Debug)]
pub(super) struct PerAddressLimit {
    most: usize,
    /// Addresses without connections have no entry.
    counts: Arc<Mutex<BTreeMap<IpAddr, usize>>>,
}

/// A permit for one connection of an address, returned on drop.
#[derive(Debug)]
pub(super) struct Permit {
    address: IpAddr,
    limit: PerAddressLimit,
}

impl PerAddressLimit {
    /// Allows each address `most` connections.
    pub(super) fn new(most: usize) -> Self {
        Self { most, counts: Arc::default() }
    }

    /// A permit for one more connection from `address`; `None` at the limit.
    pub(super) fn acquire(&self, address: IpAddr) -> Option<Permit> {
        // An IPv4-mapped IPv6 address counts as the IPv4 address.
        let address = address.to_canonical();
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(address).or_default();
        if *count == self.most {
            return None;
        }
        *count += 1;
        Some(Permit { address, limit: self.clone() })
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut counts = self.limit.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let left = counts.get(&self.address).map_or(0, |count| count - 1);
        match left {
            0 => counts.remove(&self.address),
            left => counts.insert(self.address, left),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_at_its_limit_gets_a_permit_after_one_is_returned_and_others_are_unaffected() {
        let (one, other) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        let limit = PerAddressLimit::new(2);
        let mut permits = vec![limit.acquire(one), limit.acquire(one)];
        assert!(permits.iter().all(Option::is_some) && limit.acquire(one).is_none());
        assert!(limit.acquire(other).is_some());
        permits.pop();
        assert!(limit.acquire(one).is_some());
        drop(permits);
        assert_eq!(limit.counts.lock().expect("nobody panicked").len(), 0);
    }
}
