//! Sparse non-linear least squares: Levenberg–Marquardt on normal equations with two kinds of parameter blocks.
//!
//! A problem has `A`-sized blocks (few, coupled with each other) and `B`-sized blocks (many, each coupled with some
//! `A` blocks only). The `B` blocks are eliminated by the Schur complement; the reduced system is solved by faer's sparse
//! Cholesky factorisation. Bundle adjustment has that form (A = 6, B = 3), and pose graphs (A = 6, no B blocks) as well;
//! this crate knows neither.

mod levenberg_marquardt;
mod normal_equations;
mod robust;

pub use levenberg_marquardt::{LeastSquares, Options, Summary, Termination, minimize};
pub use normal_equations::{NormalEquations, SolveError, Step};
pub use robust::RobustKernel;
