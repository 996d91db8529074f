//! Disjoint sets of numbers (Tarjan and van Leeuwen, JACM 1984). Each has a parent in its set; the root is its own, and the smallest.

/// The root of a set, halving the path.
pub(crate) fn root(parents: &mut [u32], mut i: u32) -> u32 {
    while parents[i as usize] != i {
        parents[i as usize] = parents[parents[i as usize] as usize];
        i = parents[i as usize];
    }
    i
}

/// Makes one set of two.
pub(crate) fn join(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b) as usize] = a.min(b);
}
