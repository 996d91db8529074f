//! Feature matching by descriptor distance (algorithm 1, before GMS).

use pfd_vision::features::Feature;

/// For each feature of `a` the feature of `b` with the nearest descriptor, as positions in both images.
pub(crate) fn brute_force(a: &[Feature], b: &[Feature]) -> (Vec<[f32; 2]>, Vec<[f32; 2]>) {
    let nearest = |f: &Feature| b.iter().min_by_key(|g| f.descriptor.distance(&g.descriptor));
    a.iter().filter_map(|f| nearest(f).map(|g| ([f.u, f.v], [g.u, g.v]))).unzip()
}
