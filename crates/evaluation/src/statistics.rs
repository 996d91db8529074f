//! Summary of a list of errors.

use serde::{Deserialize, Serialize};

/// Summary of errors; `std` is that of the population, as numpy and evo compute it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median; for an even number the mean of the middle two.
    pub median: f64,
    /// Standard deviation.
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// How many errors were summarised.
    pub pairs: usize,
}

impl Statistics {
    /// Summarises `errors`; `None` for an empty list.
    pub fn of(errors: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = errors.into_iter().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let (&min, &max) = (sorted.first()?, sorted.last()?);
        let count = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / count;
        let mean_square = sorted.iter().map(|e| e * e).sum::<f64>() / count;
        let variance = sorted.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / count;
        Some(Self {
            rmse: mean_square.sqrt(),
            mean,
            median: quantile_of_sorted(&sorted, 0.5),
            std: variance.sqrt(),
            min,
            max,
            pairs: sorted.len(),
        })
    }
}

/// The `q` quantile (0 to 1) with linear interpolation between neighbours; `None` for an empty list.
pub fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    (!sorted.is_empty()).then(|| quantile_of_sorted(&sorted, q))
}

fn quantile_of_sorted(sorted: &[f64], q: f64) -> f64 {
    let position = q.clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let below = position.floor();
    let (a, b) = (sorted[below as usize], sorted[position.ceil() as usize]);
    a + (b - a) * (position - below)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_numbers() {
        let s = Statistics::of([3.0, 1.0, 2.0, 4.0]).unwrap();
        assert_eq!((s.mean, s.median, s.min, s.max, s.pairs), (2.5, 2.5, 1.0, 4.0, 4));
        assert!((s.rmse - 7.5_f64.sqrt()).abs() < 1e-12 && (s.std - 1.25_f64.sqrt()).abs() < 1e-12);
        assert!(Statistics::of([]).is_none());
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&[10.0, 0.0], 0.25), Some(2.5));
        assert_eq!(quantile(&[1.0], 0.99), Some(1.0));
        assert_eq!(quantile(&[], 0.5), None);
    }
}
