//! Which measurements of two streams belong together, by time.

use crate::Stamp;

/// For each stamp of `first` the nearest stamp of `second` within `max_difference` seconds: pairs of indices.
///
/// Both lists must be sorted. A stamp of `second` may serve several of `first`; of two equally near the earlier is taken.
pub fn nearest(first: &[Stamp], second: &[Stamp], max_difference: f64) -> Vec<(usize, usize)> {
    let limit = nanos(max_difference);
    let pair = |(i, stamp): (usize, &Stamp)| {
        let j = nearest_index(second, *stamp)?;
        (difference(*stamp, second[j]) <= limit).then_some((i, j))
    };
    first.iter().enumerate().filter_map(pair).collect()
}

/// Pairs of indices such that each stamp is used at most once: the closest two first, then the closest of what is left, and
/// so on (the rule of `associate.py` of the TUM RGB-D tools). Both lists must be sorted.
pub fn one_to_one(first: &[Stamp], second: &[Stamp], max_difference: f64) -> Vec<(usize, usize)> {
    let mut candidates = candidates(first, second, nanos(max_difference));
    candidates.sort_unstable();
    let (mut first_used, mut second_used) = (vec![false; first.len()], vec![false; second.len()]);
    let mut pairs = Vec::new();
    for (_, i, j) in candidates {
        if !first_used[i] && !second_used[j] {
            (first_used[i], second_used[j]) = (true, true);
            pairs.push((i, j));
        }
    }
    pairs.sort_unstable();
    pairs
}

/// Index of the stamp nearest to `stamp` in a sorted list; `None` when the list is empty.
///
/// Of two equally near the one is taken that tools which calculate in floating-point seconds take (evo, the benchmark's tools),
/// else the earlier. Of several equal stamps at or before `stamp` it is the last, as for evo.
pub fn nearest_index(sorted: &[Stamp], stamp: Stamp) -> Option<usize> {
    let after = sorted.partition_point(|&s| s <= stamp);
    let before = after.checked_sub(1);
    let after = (after < sorted.len()).then_some(after);
    match (before, after) {
        (Some(b), Some(a)) if is_nearer(sorted[a], sorted[b], stamp) => Some(a),
        (before, after) => before.or(after),
    }
}

fn is_nearer(candidate: Stamp, other: Stamp, stamp: Stamp) -> bool {
    let seconds = |s: Stamp| (s.as_secs_f64() - stamp.as_secs_f64()).abs();
    let exact = difference(candidate, stamp).cmp(&difference(other, stamp));
    exact.then_with(|| seconds(candidate).total_cmp(&seconds(other))).is_lt()
}

/// All `(difference, i, j)` with a difference of at most `limit` nanoseconds.
fn candidates(first: &[Stamp], second: &[Stamp], limit: u64) -> Vec<(u64, usize, usize)> {
    let mut found = Vec::new();
    let mut start = 0;
    for (i, &stamp) in first.iter().enumerate() {
        while start < second.len() && second[start] < stamp && difference(second[start], stamp) > limit {
            start += 1;
        }
        let near = second[start..].iter().take_while(|&&s| s <= stamp || difference(s, stamp) <= limit);
        found.extend(near.enumerate().map(|(k, &s)| (difference(s, stamp), i, start + k)));
    }
    found
}

fn difference(a: Stamp, b: Stamp) -> u64 {
    a.as_nanos().abs_diff(b.as_nanos())
}

fn nanos(seconds: f64) -> u64 {
    // A negative or NaN limit becomes 0: only equal stamps belong together.
    (seconds * 1e9).round() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stamps(millis: &[i64]) -> Vec<Stamp> {
        millis.iter().map(|&ms| Stamp::from_nanos(ms * 1_000_000)).collect()
    }

    #[test]
    fn nearest_may_share_and_one_to_one_may_not() {
        let (rgb, depth) = (stamps(&[0, 30, 60]), stamps(&[14, 45, 80]));
        assert_eq!(nearest(&rgb, &depth, 0.02), [(0, 0), (1, 1), (2, 1)]);
        assert_eq!(one_to_one(&rgb, &depth, 0.02), [(0, 0), (1, 1), (2, 2)]);
        assert_eq!(nearest(&rgb, &depth, 0.0149), [(0, 0)]);
    }

    #[test]
    fn the_limit_is_inclusive_and_ties_go_to_the_earlier() {
        let (a, b) = (stamps(&[20]), stamps(&[0, 40]));
        assert_eq!(nearest(&a, &b, 0.02), [(0, 0)]);
        assert_eq!(one_to_one(&a, &b, 0.02), [(0, 0)]);
        assert!(nearest(&a, &[], 0.02).is_empty());
    }

    fn sorted() -> impl Strategy<Value = Vec<Stamp>> {
        prop::collection::vec(0_i64..500, 0..30).prop_map(|mut ms| {
            ms.sort_unstable();
            ms.dedup();
            stamps(&ms)
        })
    }

    proptest! {
        #[test]
        fn one_to_one_equals_the_quadratic_rule(a in sorted(), b in sorted()) {
            let mut all: Vec<_> = a.iter().enumerate()
                .flat_map(|(i, &x)| b.iter().enumerate().map(move |(j, &y)| (difference(x, y), i, j)))
                .filter(|&(d, ..)| d <= 20_000_000)
                .collect();
            all.sort_unstable();
            let mut expected: Vec<(usize, usize)> = Vec::new();
            for (_, i, j) in all {
                if expected.iter().all(|&(k, l)| k != i && l != j) {
                    expected.push((i, j));
                }
            }
            expected.sort_unstable();
            prop_assert_eq!(one_to_one(&a, &b, 0.02), expected);
        }

        #[test]
        fn nearest_is_the_minimum(a in sorted(), b in sorted()) {
            for (i, j) in nearest(&a, &b, 0.02) {
                prop_assert_eq!(b.iter().map(|&s| difference(s, a[i])).min(), Some(difference(a[i], b[j])));
            }
        }
    }
}
