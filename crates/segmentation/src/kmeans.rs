//! K-means of numbers (Lloyd's algorithm), seeded by quantiles so that it is deterministic.

/// Iterations after which the clusters are taken as they are.
const MAX_ITERATIONS: usize = 30;

/// A cluster of numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cluster {
    /// Mean.
    pub center: f32,
    /// Standard deviation.
    pub sigma: f32,
    /// Members.
    pub count: usize,
}

/// Up to `k` clusters of `values`, in ascending order; empty ones are left out.
pub fn kmeans(values: &[f32], k: usize) -> Vec<Cluster> {
    if k == 0 {
        return Vec::new();
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    let k = k.min(sorted.len());
    let mut centers: Vec<f32> = (0..k).map(|i| sorted[(2 * i + 1) * sorted.len() / (2 * k)]).collect();
    for _ in 0..MAX_ITERATIONS {
        let next: Vec<f32> = clusters(&sorted, &centers).iter().map(|c| c.center).collect();
        if next == centers {
            break;
        }
        centers = next;
    }
    clusters(&sorted, &centers).into_iter().filter(|c| c.count > 0).collect()
}

/// Index of the centre nearest to `value`.
fn nearest(centers: &[f32], value: f32) -> usize {
    let distance = |i: &usize| (centers[*i] - value).abs();
    (0..centers.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
}

fn clusters(values: &[f32], centers: &[f32]) -> Vec<Cluster> {
    let mut sums = vec![(0.0_f64, 0.0_f64, 0_usize); centers.len()];
    for &v in values {
        let s = &mut sums[nearest(centers, v)];
        *s = (s.0 + f64::from(v), s.1 + f64::from(v) * f64::from(v), s.2 + 1);
    }
    let summary = |(&(sum, squares, count), &old): (&(f64, f64, usize), &f32)| {
        if count == 0 {
            return Cluster { center: old, sigma: 0.0, count };
        }
        let mean = sum / count as f64;
        let variance = (squares / count as f64 - mean * mean).max(0.0);
        Cluster { center: mean as f32, sigma: variance.sqrt() as f32, count }
    };
    sums.iter().zip(centers).map(summary).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_groups() {
        let found = kmeans(&[1.0, 1.2, 3.0, 0.8, 3.2], 2);
        assert_eq!(found.len(), 2);
        assert!((found[0].center - 1.0).abs() < 1e-6 && found[0].count == 3);
        assert!((found[1].center - 3.1).abs() < 1e-6 && found[1].count == 2);
    }

    #[test]
    fn fewer_values_than_clusters() {
        assert!(kmeans(&[], 3).is_empty() && kmeans(&[2.0], 0).is_empty());
        assert_eq!(kmeans(&[2.0], 3), [Cluster { center: 2.0, sigma: 0.0, count: 1 }]);
    }
}
