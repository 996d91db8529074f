//! Robust kernels on squared, normalised residuals.

/// How the cost grows with the squared residual `s` (in units of its variance).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RobustKernel {
    /// `s`: plain least squares.
    Quadratic,
    /// Quadratic up to `√s = k`, linear beyond (Huber 1964).
    Huber(f64),
    /// Bounded: `k²·s / (k² + s)` (Geman and McClure 1985).
    GemanMcClure(f64),
}

impl RobustKernel {
    /// Contribution to the cost.
    pub fn cost(self, s: f64) -> f64 {
        match self {
            Self::Quadratic => s,
            Self::Huber(k) if s <= k * k => s,
            Self::Huber(k) => 2.0 * k * s.sqrt() - k * k,
            Self::GemanMcClure(k) => k * k * s / (k * k + s),
        }
    }

    /// Derivative of the cost by `s`: the weight of iteratively reweighted least squares.
    pub fn weight(self, s: f64) -> f64 {
        match self {
            Self::Quadratic => 1.0,
            Self::Huber(k) if s <= k * k => 1.0,
            Self::Huber(k) => k / s.sqrt(),
            Self::GemanMcClure(k) => (k * k / (k * k + s)).powi(2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn weight_is_the_derivative_of_the_cost(s in 0.01..100.0_f64, k in 0.5..5.0_f64) {
            for kernel in [RobustKernel::Quadratic, RobustKernel::Huber(k), RobustKernel::GemanMcClure(k)] {
                let h = 1e-6 * s;
                let numeric = (kernel.cost(s + h) - kernel.cost(s - h)) / (2.0 * h);
                prop_assert!((numeric - kernel.weight(s)).abs() < 1e-4);
            }
        }
    }
}
