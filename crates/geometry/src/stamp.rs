//! Time stamps with nanosecond resolution.

use std::fmt;
use std::str::FromStr;

const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// A point in time: nanoseconds since the epoch of the clock that took it (Unix time, or simulated time).
///
/// Integers, not floating-point seconds: today's Unix time in an `f64` has a resolution of 0.2 µs only, and stamps are compared
/// for equality (a mask belongs to the image with the same stamp).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Stamp(i64);

impl Stamp {
    /// A stamp from nanoseconds since the epoch.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// A stamp from the two fields of `builtin_interfaces/Time`.
    pub const fn from_sec_nanosec(sec: i32, nanosec: u32) -> Self {
        Self(sec as i64 * NANOS_PER_SECOND + nanosec as i64)
    }

    /// Nanoseconds since the epoch.
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// The two fields of `builtin_interfaces/Time`.
    pub const fn to_sec_nanosec(self) -> (i32, u32) {
        (self.0.div_euclid(NANOS_PER_SECOND) as i32, self.0.rem_euclid(NANOS_PER_SECOND) as u32)
    }

    /// Seconds since the epoch, rounded to the resolution of an `f64`.
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 / NANOS_PER_SECOND as f64
    }

    /// The stamp nearest to `seconds`; `None` when `seconds` is not finite or out of range.
    pub fn from_secs_f64(seconds: f64) -> Option<Self> {
        let nanos = (seconds * NANOS_PER_SECOND as f64).round();
        (nanos.is_finite() && nanos.abs() < i64::MAX as f64).then_some(Self(nanos as i64))
    }

    /// `self - earlier` in seconds; negative when `earlier` is later.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (i128::from(self.0) - i128::from(earlier.0)) as f64 / NANOS_PER_SECOND as f64
    }

    /// This stamp moved by `seconds` (saturating).
    #[must_use]
    pub fn offset_by(self, seconds: f64) -> Self {
        Self(self.0.saturating_add((seconds * NANOS_PER_SECOND as f64).round() as i64))
    }
}

/// Text that is not a stamp in seconds.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a time stamp in seconds, such as 1305031102.175304")]
pub struct StampError(String);

impl FromStr for Stamp {
    type Err = StampError;

    /// Parses decimal seconds exactly, without a detour over `f64`; digits beyond nanoseconds are dropped.
    /// Exponents are read as floating point.
    fn from_str(text: &str) -> Result<Self, StampError> {
        let fail = || StampError(text.to_owned());
        let (negative, digits) = match text.strip_prefix('-') {
            Some(rest) => (true, rest),
            None => (false, text),
        };
        let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
        let plain = |part: &str| part.bytes().all(|b| b.is_ascii_digit());
        if whole.is_empty() || !plain(whole) || !plain(fraction) {
            let seconds: f64 = text.parse().map_err(|_| fail())?;
            return Self::from_secs_f64(seconds).ok_or_else(fail);
        }
        let seconds: i64 = whole.parse().map_err(|_| fail())?;
        let mut nanos = 0_i64;
        for digit in fraction.bytes().chain(std::iter::repeat(b'0')).take(9) {
            nanos = nanos * 10 + i64::from(digit - b'0');
        }
        let total = seconds.checked_mul(NANOS_PER_SECOND).and_then(|s| s.checked_add(nanos)).ok_or_else(fail)?;
        Ok(Self(if negative { -total } else { total }))
    }
}

impl fmt::Display for Stamp {
    /// Seconds with six decimals (as TUM files have them), nine where the stamp needs them.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let nanos = self.0.unsigned_abs();
        let (seconds, rest) = (nanos / NANOS_PER_SECOND as u64, nanos % NANOS_PER_SECOND as u64);
        if rest.is_multiple_of(1000) {
            write!(f, "{sign}{seconds}.{:06}", rest / 1000)
        } else {
            write!(f, "{sign}{seconds}.{rest:09}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn parses_tum_stamps_exactly() {
        let stamp: Stamp = "1305031102.175304".parse().unwrap();
        assert_eq!(stamp.as_nanos(), 1_305_031_102_175_304_000);
        assert_eq!(stamp.to_string(), "1305031102.175304");
        assert_eq!("1.3e9".parse::<Stamp>().unwrap().as_nanos(), 1_300_000_000_000_000_000);
        for bad in ["", "abc", "1.2.3", "nan", "inf", "1e300", "99999999999999999999"] {
            assert!(bad.parse::<Stamp>().is_err(), "{bad}");
        }
    }

    proptest! {
        #[test]
        fn display_and_parse_are_inverse(nanos in any::<i64>().prop_filter("abs", |n| *n != i64::MIN)) {
            let stamp = Stamp::from_nanos(nanos);
            prop_assert_eq!(stamp.to_string().parse::<Stamp>().unwrap(), stamp);
        }

        #[test]
        fn ros_fields_are_inverse(sec in any::<i32>(), nanosec in 0_u32..1_000_000_000) {
            prop_assert_eq!(Stamp::from_sec_nanosec(sec, nanosec).to_sec_nanosec(), (sec, nanosec));
        }

        #[test]
        fn any_text_parses_or_is_refused(text in ".{0,40}") {
            let _ = text.parse::<Stamp>();
        }
    }
}
