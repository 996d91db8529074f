//! Which networks the node talks on, and whether the kernel's buffers are large enough for images.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, UdpSocket};
use std::path::Path;
use std::time::Duration;

use rustdds::{DomainParticipant, DomainParticipantBuilder};

use crate::{RosError, Throttle};

/// Buffers that take a few images; smaller ones lose most of them.
const NEEDED_BUFFER: u64 = 4 << 20;

/// How often to look whether an interface is back.
const LOOK_FOR_INTERFACES: Duration = Duration::from_secs(1);

/// Interfaces to use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Networks {
    /// All interfaces.
    All,
    /// Interfaces with these addresses.
    Only(Vec<IpAddr>),
}

impl fmt::Display for Networks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all networks"),
            Self::Only(addresses) => {
                let addresses: Vec<String> = addresses.iter().map(ToString::to_string).collect();
                write!(f, "{} only (parameter `network`)", addresses.join(", "))
            }
        }
    }
}

impl Networks {
    /// Loopback only: other machines neither see nor are seen.
    pub fn loopback() -> Self {
        Self::Only(vec![Ipv4Addr::LOCALHOST.into()])
    }

    /// The networks that parameter `network` names; `environment` looks up variables.
    ///
    /// # Errors
    /// [`RosError`] when the parameter or a variable makes no sense.
    pub fn choose(parameter: &str, environment: impl Fn(&str) -> Option<String>) -> Result<Self, RosError> {
        match parameter {
            "auto" | "" => Self::from_environment(environment),
            "loopback" => Ok(Self::loopback()),
            "subnet" => Ok(Self::All),
            addresses => {
                // The transport knows IPv4 only.
                let parsed = addresses.split(',').map(|a| a.trim().parse::<Ipv4Addr>().map(IpAddr::from));
                parsed.collect::<Result<_, _>>().map(Self::Only).map_err(|_| RosError::Network(addresses.to_owned()))
            }
        }
    }

    /// Whether this machine has the addresses: the middleware would join nothing at all without a word.
    ///
    /// # Errors
    /// [`RosError::NoInterface`] with the first that it does not have.
    pub(crate) fn check(&self) -> Result<(), RosError> {
        let Self::Only(addresses) = self else { return Ok(()) };
        match addresses.iter().find(|address| UdpSocket::bind((**address, 0)).is_err()) {
            Some(&address) => Err(RosError::NoInterface(address)),
            None => Ok(()),
        }
    }

    /// Waits until the addresses are there.
    pub(crate) async fn available(&self) {
        let mut ticks = tokio::time::interval(LOOK_FOR_INTERFACES);
        let mut complaints = Throttle::default();
        loop {
            ticks.tick().await;
            let Err(error) = self.check() else { return };
            if complaints.pass().is_some() {
                tracing::warn!("{error}; waiting for it");
            }
        }
    }

    /// `ROS_AUTOMATIC_DISCOVERY_RANGE` (Iron and later), `ROS_LOCALHOST_ONLY` (before), else loopback.
    fn from_environment(environment: impl Fn(&str) -> Option<String>) -> Result<Self, RosError> {
        let unknown = |variable, value, expected| Err(RosError::Environment { variable, value, expected });
        if let Some(range) = environment("ROS_AUTOMATIC_DISCOVERY_RANGE") {
            return match range.as_str() {
                "SUBNET" | "SYSTEM_DEFAULT" => Ok(Self::All),
                "LOCALHOST" | "OFF" | "" => Ok(Self::loopback()),
                _ => {
                    unknown("ROS_AUTOMATIC_DISCOVERY_RANGE", range, "expected LOCALHOST, SUBNET, SYSTEM_DEFAULT or OFF")
                }
            };
        }
        match environment("ROS_LOCALHOST_ONLY").as_deref() {
            None | Some("1" | "") => Ok(Self::loopback()),
            Some("0") => Ok(Self::All),
            Some(other) => unknown("ROS_LOCALHOST_ONLY", other.to_owned(), "expected 0 or 1"),
        }
    }
}

/// The domain by `ROS_DOMAIN_ID`, 0 when it is not set.
///
/// # Errors
/// [`RosError::Environment`] when it is not a number that DDS's port scheme allows.
pub fn domain(environment: impl Fn(&str) -> Option<String>) -> Result<u16, RosError> {
    /// Beyond it port numbers do not fit.
    const MAX_DOMAIN: u16 = 232;
    let Some(text) = environment("ROS_DOMAIN_ID").filter(|text| !text.is_empty()) else { return Ok(0) };
    text.parse().ok().filter(|id| *id <= MAX_DOMAIN).ok_or(RosError::Environment {
        variable: "ROS_DOMAIN_ID",
        value: text,
        expected: "expected a whole number from 0 to 232",
    })
}

/// Joins a domain.
///
/// # Errors
/// [`RosError::Participant`] when the sockets cannot be opened.
pub fn join(domain: u16, networks: &Networks) -> Result<DomainParticipant, RosError> {
    let builder = DomainParticipantBuilder::new(domain);
    let builder = match networks {
        Networks::All => builder,
        Networks::Only(addresses) => builder.with_only_networks(addresses.iter().copied()),
    };
    builder.build().map_err(|e| RosError::Participant { domain, reason: e.to_string() })
}

/// What to say when the kernel's receive buffers are too small for images; `None` when they will do.
pub fn buffer_advice() -> Option<String> {
    advice(read_number(Path::new("/proc/sys/net/core/rmem_max"))?)
}

fn advice(rmem_max: u64) -> Option<String> {
    (rmem_max < NEEDED_BUFFER).then(|| {
        format!(
            "net.core.rmem_max is {rmem_max} bytes: most images will be lost. Run: sudo sysctl -w net.core.rmem_max={NEEDED_BUFFER} \
             net.core.rmem_default={NEEDED_BUFFER} (rmem_default is for subscribers that do not ask, such as rviz)"
        )
    })
}

fn read_number(path: &Path) -> Option<u64> {
    std::fs::read_to_string(path).ok()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choose(parameter: &str, variable: Option<(&str, &str)>) -> Result<Networks, RosError> {
        Networks::choose(parameter, |name| variable.filter(|(n, _)| *n == name).map(|(_, v)| v.to_owned()))
    }

    #[test]
    fn loopback_unless_told_otherwise() {
        assert_eq!(choose("auto", None).unwrap(), Networks::loopback());
        assert_eq!(choose("auto", Some(("ROS_LOCALHOST_ONLY", "1"))).unwrap(), Networks::loopback());
        assert_eq!(choose("auto", Some(("ROS_LOCALHOST_ONLY", "0"))).unwrap(), Networks::All);
        assert_eq!(choose("auto", Some(("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"))).unwrap(), Networks::All);
        assert_eq!(choose("loopback", Some(("ROS_LOCALHOST_ONLY", "0"))).unwrap(), Networks::loopback());
        assert_eq!(
            choose("192.168.1.2, 10.0.0.1", None).unwrap(),
            Networks::Only(vec!["192.168.1.2".parse().unwrap(), "10.0.0.1".parse().unwrap()])
        );
        assert!(choose("wlan0", None).is_err());
        assert!(choose("::1", None).is_err());
        assert!(choose("auto", Some(("ROS_AUTOMATIC_DISCOVERY_RANGE", "MOON"))).is_err());
    }

    #[test]
    fn an_address_that_no_interface_has_is_named() {
        assert!(Networks::loopback().check().is_ok() && Networks::All.check().is_ok());
        // Of a block that is reserved for documentation.
        let elsewhere = choose("127.0.0.1, 192.0.2.7", None).unwrap();
        assert!(elsewhere.check().unwrap_err().to_string().contains("192.0.2.7"));
    }

    #[test]
    fn domains_are_checked() {
        let with = |text: &'static str| domain(move |_| Some(text.to_owned()));
        assert_eq!((domain(|_| None).unwrap(), with("").unwrap(), with("42").unwrap()), (0, 0, 42));
        assert!(with("233").is_err() && with("-1").is_err() && with("x").is_err());
    }

    #[test]
    fn advice_only_where_needed() {
        assert!(advice(212_992).unwrap().contains("sysctl -w net.core.rmem_max=4194304"));
        assert_eq!(advice(NEEDED_BUFFER), None);
    }
}
