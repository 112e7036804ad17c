//! How many connections each address has.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Open connections by address.
#[derive(Clone, Debug)]
pub(super) struct Crowd {
    most: usize,
    /// Addresses without connections are not kept.
    of: Arc<Mutex<BTreeMap<IpAddr, usize>>>,
}

/// One connection's place among those of its address; it is free again when this is dropped.
#[derive(Debug)]
pub(super) struct Place {
    address: IpAddr,
    crowd: Crowd,
}

impl Crowd {
    /// An address has `most` places.
    pub(super) fn new(most: usize) -> Self {
        Self { most, of: Arc::default() }
    }

    /// A place for one more connection from `address`, if there is one.
    pub(super) fn admit(&self, address: IpAddr) -> Option<Place> {
        // An IPv4 address counts as itself, also where it comes as one of IPv6.
        let address = address.to_canonical();
        let mut of = self.of.lock().unwrap_or_else(PoisonError::into_inner);
        let count = of.entry(address).or_default();
        if *count == self.most {
            return None;
        }
        *count += 1;
        Some(Place { address, crowd: self.clone() })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut of = self.crowd.of.lock().unwrap_or_else(PoisonError::into_inner);
        let left = of.get(&self.address).map_or(0, |count| count - 1);
        match left {
            0 => of.remove(&self.address),
            left => of.insert(self.address, left),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_has_all_its_places_gets_one_when_one_is_free_and_others_do_not_wait() {
        let (one, other) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        let crowd = Crowd::new(2);
        let mut places = vec![crowd.admit(one), crowd.admit(one)];
        assert!(places.iter().all(Option::is_some) && crowd.admit(one).is_none());
        assert!(crowd.admit(other).is_some());
        places.pop();
        assert!(crowd.admit(one).is_some());
        drop(places);
        assert_eq!(crowd.of.lock().expect("nobody panicked").len(), 0);
    }
}
