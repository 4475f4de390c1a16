//! Permits for connections, of which one address does not have all: nobody keeps all others out.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use evermap_schemas::Fault;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Permits of one protocol.
pub struct Permits {
    all: Arc<Semaphore>,
    taken: Arc<AddressCounts>,
    /// Of one address.
    most: usize,
    /// Whether this machine is an address as others. Those who come through it, by ssh or a proxy, may be many.
    counts_loopback: bool,
}

/// How many permits addresses have; none where there is no entry.
#[derive(Default)]
struct AddressCounts(Mutex<HashMap<IpAddr, usize>>);

/// The permit of a connection, until it is dropped.
pub struct Permit {
    _of_all: OwnedSemaphorePermit,
    taken: Arc<AddressCounts>,
    host: IpAddr,
}

/// Why there is no permit.
#[derive(Debug)]
pub enum Full {
    /// Nobody gets one.
    All,
    /// This address has as many as it may have.
    Address(Fault),
}

impl Permits {
    /// So many permits. One address has so many of them as is said, else half of what is `contested`, of these or of
    /// permits behind them, and this machine any number.
    pub fn new(all: usize, contested: usize, said: Option<u32>) -> Self {
        let said = said.and_then(|most| usize::try_from(most).ok());
        Self {
            all: Arc::new(Semaphore::new(all)),
            taken: Arc::default(),
            most: said.unwrap_or(contested / 2).max(1),
            counts_loopback: said.is_some(),
        }
    }

    /// A permit for somebody of an address.
    ///
    /// # Errors
    /// Where there is none, and why.
    pub fn take(&self, address: IpAddr) -> Result<Permit, Full> {
        let of_all = Arc::clone(&self.all).try_acquire_owned();
        let of_all = of_all.map_err(|_| Full::All)?;
        let host = host_of(address);
        let is_counted = self.counts_loopback || !host.is_loopback();
        let mut taken = self.taken.held();
        let count = taken.entry(host).or_default();
        if is_counted && *count >= self.most {
            return Err(Full::Address(self.told(address)));
        }
        *count += 1;
        drop(taken);
        Ok(Permit {
            _of_all: of_all,
            taken: Arc::clone(&self.taken),
            host,
        })
    }

    fn told(&self, address: IpAddr) -> Fault {
        let (most, address) = (self.most, address.to_canonical());
        Fault::resource(format!(
            "expected at most {most} connections from {address} at once, found one more"
        ))
        .next("close some, or start the server with --per-address, as behind a proxy")
    }
}

impl AddressCounts {
    fn held(&self) -> MutexGuard<'_, HashMap<IpAddr, usize>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut taken = self.taken.held();
        if let Some(count) = taken.get_mut(&self.host) {
            *count -= 1;
            if *count == 0 {
                taken.remove(&self.host);
            }
        }
    }
}

/// Whom an address is counted for: of IPv6, a machine may have any of the 2^64 that begin alike.
fn host_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) if !address.is_loopback() => {
            let network = u128::from(address) & !u128::from(u64::MAX);
            IpAddr::V6(Ipv6Addr::from(network))
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Permits that one address gets at once of these, and as many of another then.
    fn taken(permits: &Permits, address: &str, other: &str) -> (usize, usize) {
        let all = |address: &str| {
            let address = address.parse().unwrap();
            let taken = std::iter::from_fn(|| permits.take(address).ok());
            taken.take(100).collect::<Vec<Permit>>()
        };
        let (first, then) = (all(address), all(other));
        (first.len(), then.len())
    }

    #[test]
    fn one_address_does_not_have_all_places() {
        let permits = Permits::new(10, 8, None);
        for _ in 0..2 {
            let two = taken(&permits, "192.0.2.1", "192.0.2.2");
            assert_eq!(two, (4, 4));
        }
        // Of one machine, and of two.
        assert_eq!(taken(&permits, "2001:db8::1", "2001:db8::2:1"), (4, 0));
        assert_eq!(taken(&permits, "2001:db8::1", "2001:db8:0:1::1"), (4, 4));
        assert_eq!(taken(&permits, "192.0.2.1", "::ffff:192.0.2.1"), (4, 0));
        // Whoever comes through this machine.
        assert_eq!(taken(&permits, "127.0.0.1", "192.0.2.1"), (10, 0));
        assert_eq!(taken(&permits, "::1", "127.0.0.1"), (10, 0));
        assert!(permits.taken.held().is_empty());
    }

    #[test]
    fn what_is_said_holds_for_every_address() {
        let two = Permits::new(10, 8, Some(2));
        assert_eq!(taken(&two, "192.0.2.1", "127.0.0.1"), (2, 2));
        let any = Permits::new(10, 8, Some(100_000));
        assert_eq!(taken(&any, "192.0.2.1", "192.0.2.2"), (10, 0));
        let one = Permits::new(1, 1, None);
        assert_eq!(taken(&one, "192.0.2.1", "192.0.2.2"), (1, 0));
    }

    #[test]
    fn who_gets_none_is_told_why() {
        let permits = Permits::new(3, 2, None);
        let address: IpAddr = "::ffff:192.0.2.1".parse().unwrap();
        let _first = permits.take(address).ok().unwrap();
        let Err(Full::Address(told)) = permits.take(address) else {
            unreachable!("a second one");
        };
        let says = "expected at most 1 connections from 192.0.2.1 at once";
        assert!(told.message.starts_with(says), "{told}");
        assert!(told.next.contains("--per-address"), "{told}");
        let others = ["192.0.2.2", "192.0.2.3"].map(|other| permits.take(other.parse().unwrap()));
        assert!(others.iter().all(Result::is_ok));
        let none = permits.take("192.0.2.4".parse().unwrap());
        assert!(matches!(none, Err(Full::All)));
    }
}
