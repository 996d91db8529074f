//! Levenberg–Marquardt (Madsen, Nielsen and Tingleff, "Methods for non-linear least squares problems", 2004, algorithm 3.16).

use crate::{NormalEquations, Step};

/// A problem that [`minimize`] can solve. Cloned for every trial step.
pub trait LeastSquares<const A: usize, const B: usize>: Clone {
    /// Number of free `A` blocks and of free `B` blocks.
    fn sizes(&self) -> (usize, usize);
    /// Adds every residual, linearised at the current parameters.
    fn linearize(&self, equations: &mut NormalEquations<A, B>);
    /// The robust cost at the current parameters.
    fn cost(&self) -> f64;
    /// Moves the parameters.
    fn apply(&mut self, step: &Step<A, B>);
}

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Linearisations at most.
    pub max_iterations: usize,
    /// Stop when the cost falls by less than this share.
    pub relative_decrease: f64,
    /// Damping at the start, relative to the diagonal of the Hessian.
    pub initial_damping: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { max_iterations: 10, relative_decrease: 1e-6, initial_damping: 1e-4 }
    }
}

/// Why [`minimize`] stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// The cost no longer falls, or the gradient vanished.
    Converged,
    /// The limit of iterations was reached.
    MaxIterations,
    /// No damping gave a step that lowers the cost, or the system could not be solved.
    Stalled,
}

/// What [`minimize`] did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Cost before.
    pub initial_cost: f64,
    /// Cost after; never above `initial_cost`.
    pub final_cost: f64,
    /// Linearisations.
    pub iterations: usize,
    /// Why it stopped.
    pub termination: Termination,
}

/// Damping beyond which no step is expected to help.
const MAX_DAMPING: f64 = 1e8;
/// A gradient below this is zero.
const GRADIENT_TOLERANCE: f64 = 1e-12;

/// Lowers the cost of `problem` until it converges.
pub fn minimize<const A: usize, const B: usize, P: LeastSquares<A, B>>(problem: &mut P, options: &Options) -> Summary {
    let initial_cost = problem.cost();
    let mut summary =
        Summary { initial_cost, final_cost: initial_cost, iterations: 0, termination: Termination::MaxIterations };
    let mut damping = options.initial_damping;
    while summary.iterations < options.max_iterations {
        summary.iterations += 1;
        let (a, b) = problem.sizes();
        let mut equations = NormalEquations::new(a, b);
        problem.linearize(&mut equations);
        if equations.gradient_norm() < GRADIENT_TOLERANCE {
            summary.termination = Termination::Converged;
            break;
        }
        let Some((better, cost)) = try_steps(problem, &equations, summary.final_cost, &mut damping) else {
            summary.termination = Termination::Stalled;
            break;
        };
        let decrease = (summary.final_cost - cost) / summary.final_cost;
        *problem = better;
        summary.final_cost = cost;
        if decrease < options.relative_decrease {
            summary.termination = Termination::Converged;
            break;
        }
    }
    summary
}

/// Raises the damping until a step lowers the cost; `None` when none does.
fn try_steps<const A: usize, const B: usize, P: LeastSquares<A, B>>(
    problem: &P,
    equations: &NormalEquations<A, B>,
    cost: f64,
    damping: &mut f64,
) -> Option<(P, f64)> {
    const LESS: f64 = 0.2;
    const MIN_DAMPING: f64 = 1e-10;
    let mut growth = 4.0;
    while *damping < MAX_DAMPING {
        if let Ok(step) = equations.solve(*damping) {
            let mut trial = problem.clone();
            trial.apply(&step);
            let trial_cost = trial.cost();
            if trial_cost < cost {
                *damping = (*damping * LESS).max(MIN_DAMPING);
                return Some((trial, trial_cost));
            }
        }
        *damping *= growth;
        growth *= 2.0;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, SVector, Vector2};

    /// Rosenbrock's function as least squares: residuals `10·(y − x²)` and `1 − x`, minimum at (1, 1).
    #[derive(Clone)]
    struct Rosenbrock(Vector2<f64>);

    impl LeastSquares<2, 1> for Rosenbrock {
        fn sizes(&self) -> (usize, usize) {
            (1, 0)
        }
        fn linearize(&self, equations: &mut NormalEquations<2, 1>) {
            let jacobian = SMatrix::<f64, 2, 2>::new(-20.0 * self.0.x, 10.0, -1.0, 0.0);
            equations.add_pair(Some((0, &jacobian)), None, &self.residual(), 1.0);
        }
        fn cost(&self) -> f64 {
            self.residual().norm_squared()
        }
        fn apply(&mut self, step: &Step<2, 1>) {
            self.0 += step.a[0];
        }
    }

    impl Rosenbrock {
        fn residual(&self) -> SVector<f64, 2> {
            Vector2::new(10.0 * (self.0.y - self.0.x * self.0.x), 1.0 - self.0.x)
        }
    }

    #[test]
    fn finds_the_minimum_of_rosenbrock() {
        let mut problem = Rosenbrock(Vector2::new(-1.2, 1.0));
        let summary = minimize(&mut problem, &Options { max_iterations: 100, ..Options::default() });
        assert!((problem.0 - Vector2::new(1.0, 1.0)).norm() < 1e-6, "{problem:?}", problem = problem.0);
        assert!(summary.final_cost < 1e-12 && summary.initial_cost > 20.0);
    }

    #[test]
    fn at_the_minimum_it_stops_at_once() {
        let mut problem = Rosenbrock(Vector2::new(1.0, 1.0));
        let summary = minimize(&mut problem, &Options::default());
        assert_eq!((summary.iterations, summary.termination), (1, Termination::Converged));
    }
}
