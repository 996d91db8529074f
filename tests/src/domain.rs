//! DDS domains that no other test uses at the same time.

use std::fmt;
use std::fs::{File, OpenOptions};

use anyhow::Context;

/// Low domains are those that people use.
const FIRST: u32 = 20;
/// The ports of higher domains are among those that the system hands out to anyone.
const LAST: u32 = 100;

/// A domain, reserved on this machine until it is dropped.
#[derive(Debug)]
pub struct Domain {
    id: u16,
    /// Locked; the system lets go of it however the test ends.
    _reservation: File,
}

impl Domain {
    /// A domain that is free.
    ///
    /// # Errors
    /// When all are in use.
    pub fn reserve() -> anyhow::Result<Self> {
        let count = LAST - FIRST + 1;
        let candidates = (0..count).map(|i| FIRST + (std::process::id() + i) % count);
        candidates.into_iter().find_map(Self::try_reserve).context("all DDS domains for tests are in use")
    }

    fn try_reserve(id: u32) -> Option<Self> {
        let path = std::env::temp_dir().join(format!("pfd-slam-domain-{id}.lock"));
        let reservation = OpenOptions::new().create(true).truncate(false).write(true).open(path).ok()?;
        reservation.try_lock().ok()?;
        Some(Self { id: u16::try_from(id).ok()?, _reservation: reservation })
    }

    /// For `ROS_DOMAIN_ID`.
    pub fn id(&self) -> u16 {
        self.id
    }
}

impl fmt::Display for Domain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.id.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_reservations_differ() {
        let (first, second) = (Domain::reserve().unwrap(), Domain::reserve().unwrap());
        assert_ne!(first.id(), second.id());
        assert!((FIRST..=LAST).contains(&u32::from(first.id())));
    }
}
