//! What can go wrong with the transport.

/// A failure that names the topic, argument or message at fault and says what would be right.
#[derive(Debug, thiserror::Error)]
pub enum RosError {
    /// The command line is wrong.
    #[error("{0}")]
    Arguments(String),
    /// Not a name that ROS 2 allows.
    #[error(
        "`{0}` is not a topic or service name: letters, digits and `_`, separated by `/`, no part beginning with a digit"
    )]
    Name(String),
    /// The participant could not be made.
    #[error("cannot join DDS domain {domain}: {reason}; are there 120 participants already, or is the network down?")]
    Participant {
        /// `ROS_DOMAIN_ID`.
        domain: u16,
        /// What the middleware says.
        reason: String,
    },
    /// A publisher, subscription or service could not be made.
    #[error("cannot create {what} `{name}`: {reason}")]
    Endpoint {
        /// Publisher, subscription or service.
        what: &'static str,
        /// Full name of the topic or service.
        name: String,
        /// What the middleware says.
        reason: String,
    },
    /// Environment variable with a value that makes no sense.
    #[error("{variable}={value}: {expected}")]
    Environment {
        /// Its name.
        variable: &'static str,
        /// Its value.
        value: String,
        /// What would be right.
        expected: &'static str,
    },
    /// Parameter `network` is neither a keyword nor an address.
    #[error("parameter `network`: `{0}` is neither auto, loopback, subnet nor a list of IPv4 addresses")]
    Network(String),
    /// Parameter `network` names an address that no interface has.
    #[error("parameter `network`: no interface of this machine has the address {0}: see `ip address`")]
    NoInterface(std::net::IpAddr),
    /// Parameters that cannot be used.
    #[error(transparent)]
    Parameters(#[from] pfd_parameters::ParameterError),
}
