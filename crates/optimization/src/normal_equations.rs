//! Normal equations in blocks and their solution by the Schur complement.

use std::collections::BTreeMap;

use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use nalgebra::{SMatrix, SVector};

/// Why the normal equations have no solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SolveError {
    /// A block or the reduced system is not positive definite: some parameter is not observed.
    #[error("the normal equations are not positive definite: some parameter is not observed")]
    NotPositiveDefinite,
}

/// A change of all parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Step<const A: usize, const B: usize> {
    /// One vector for each `A` block.
    pub a: Vec<SVector<f64, A>>,
    /// One vector for each `B` block.
    pub b: Vec<SVector<f64, B>>,
}

/// Gauss–Newton approximation `H·δ = -g` of a least-squares problem, in blocks.
#[derive(Clone, Debug)]
pub struct NormalEquations<const A: usize, const B: usize> {
    /// Upper triangle: key `(i, j)` with `i <= j`.
    hessian_a: BTreeMap<(usize, usize), SMatrix<f64, A, A>>,
    gradient_a: Vec<SVector<f64, A>>,
    hessian_b: Vec<SMatrix<f64, B, B>>,
    gradient_b: Vec<SVector<f64, B>>,
    /// For each `B` block the `A` blocks that it is coupled with.
    coupling: Vec<Vec<(usize, SMatrix<f64, A, B>)>>,
}

impl<const A: usize, const B: usize> NormalEquations<A, B> {
    /// Empty equations for `a` and `b` blocks.
    pub fn new(a: usize, b: usize) -> Self {
        Self {
            hessian_a: (0..a).map(|i| ((i, i), SMatrix::zeros())).collect(),
            gradient_a: vec![SVector::zeros(); a],
            hessian_b: vec![SMatrix::zeros(); b],
            gradient_b: vec![SVector::zeros(); b],
            coupling: vec![Vec::new(); b],
        }
    }

    /// Adds a residual that depends on one `A` block and one `B` block; `None` for a block that is held fixed.
    ///
    /// Residual and Jacobians are normalised by the measurement's standard deviation; `weight` is that of the robust kernel.
    pub fn add<const R: usize>(
        &mut self,
        a: Option<(usize, &SMatrix<f64, R, A>)>,
        b: Option<(usize, &SMatrix<f64, R, B>)>,
        residual: &SVector<f64, R>,
        weight: f64,
    ) {
        if let Some((i, jacobian)) = a {
            self.add_diagonal_a(i, jacobian, residual, weight);
        }
        if let Some((k, jacobian)) = b {
            self.hessian_b[k] += jacobian.transpose() * jacobian * weight;
            self.gradient_b[k] += jacobian.transpose() * residual * weight;
        }
        if let (Some((i, jacobian_a)), Some((k, jacobian_b))) = (a, b) {
            let product = jacobian_a.transpose() * jacobian_b * weight;
            match self.coupling[k].iter_mut().find(|(index, _)| *index == i) {
                Some((_, block)) => *block += product,
                None => self.coupling[k].push((i, product)),
            }
        }
    }

    /// Adds a residual that depends on two different `A` blocks; `None` for a block that is held fixed.
    pub fn add_pair<const R: usize>(
        &mut self,
        first: Option<(usize, &SMatrix<f64, R, A>)>,
        second: Option<(usize, &SMatrix<f64, R, A>)>,
        residual: &SVector<f64, R>,
        weight: f64,
    ) {
        for (i, jacobian) in [first, second].into_iter().flatten() {
            self.add_diagonal_a(i, jacobian, residual, weight);
        }
        if let (Some((i, jacobian_i)), Some((j, jacobian_j))) = (first, second) {
            let product = jacobian_i.transpose() * jacobian_j * weight;
            let (key, block) = if i <= j { ((i, j), product) } else { ((j, i), product.transpose()) };
            *self.hessian_a.entry(key).or_insert_with(SMatrix::zeros) += block;
        }
    }

    fn add_diagonal_a<const R: usize>(
        &mut self,
        i: usize,
        jacobian: &SMatrix<f64, R, A>,
        residual: &SVector<f64, R>,
        weight: f64,
    ) {
        *self.hessian_a.entry((i, i)).or_insert_with(SMatrix::zeros) += jacobian.transpose() * jacobian * weight;
        self.gradient_a[i] += jacobian.transpose() * residual * weight;
    }

    /// The largest magnitude in the gradient.
    pub fn gradient_norm(&self) -> f64 {
        let a = self.gradient_a.iter().map(SVector::amax);
        a.chain(self.gradient_b.iter().map(SVector::amax)).fold(0.0, f64::max)
    }

    /// Solves `(H + λ·diag(H))·δ = -g` (Marquardt's damping).
    ///
    /// # Errors
    /// [`SolveError::NotPositiveDefinite`] when a parameter is not observed.
    pub fn solve(&self, damping: f64) -> Result<Step<A, B>, SolveError> {
        let inverse_b = self.invert_b_blocks(damping)?;
        let mut reduced = self.hessian_a.clone();
        for (&(i, j), block) in &mut reduced {
            if i == j {
                damp(block, damping);
            }
        }
        let mut rhs: Vec<SVector<f64, A>> = self.gradient_a.iter().map(|g| -g).collect();
        for (k, inverse) in inverse_b.iter().enumerate() {
            self.eliminate(k, inverse, &mut reduced, &mut rhs);
        }
        let a = solve_reduced(&reduced, &rhs)?;
        let b = self.back_substitute(&inverse_b, &a);
        Ok(Step { a, b })
    }

    fn invert_b_blocks(&self, damping: f64) -> Result<Vec<SMatrix<f64, B, B>>, SolveError> {
        self.hessian_b
            .iter()
            .map(|block| {
                let mut damped = *block;
                damp(&mut damped, damping);
                invert_positive_definite(&damped).ok_or(SolveError::NotPositiveDefinite)
            })
            .collect()
    }

    /// Subtracts what block `k` contributes: `S -= W·V⁻¹·Wᵀ`, `rhs += W·V⁻¹·g`.
    fn eliminate(
        &self,
        k: usize,
        inverse: &SMatrix<f64, B, B>,
        reduced: &mut BTreeMap<(usize, usize), SMatrix<f64, A, A>>,
        rhs: &mut [SVector<f64, A>],
    ) {
        let couplings = &self.coupling[k];
        for (i, block_i) in couplings {
            let scaled = block_i * inverse;
            rhs[*i] += scaled * self.gradient_b[k];
            for (j, block_j) in couplings.iter().filter(|(j, _)| i <= j) {
                *reduced.entry((*i, *j)).or_insert_with(SMatrix::zeros) -= scaled * block_j.transpose();
            }
        }
    }

    fn back_substitute(&self, inverse_b: &[SMatrix<f64, B, B>], a: &[SVector<f64, A>]) -> Vec<SVector<f64, B>> {
        let solve = |k: usize| {
            let coupled: SVector<f64, B> = self.coupling[k].iter().map(|(i, block)| block.transpose() * a[*i]).sum();
            -(inverse_b[k] * (self.gradient_b[k] + coupled))
        };
        (0..self.hessian_b.len()).map(solve).collect()
    }
}

/// Adds `λ·diag`, with a floor so that a zero on the diagonal is damped as well.
fn damp<const N: usize>(block: &mut SMatrix<f64, N, N>, damping: f64) {
    const FLOOR: f64 = 1e-9;
    for i in 0..N {
        block[(i, i)] += damping * block[(i, i)].max(FLOOR);
    }
}

/// The inverse by Cholesky factorisation; `None` unless positive definite.
fn invert_positive_definite<const N: usize>(block: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    // nalgebra's Cholesky wants dimension bounds that const generics cannot state, so the few lines stand here.
    let mut lower = SMatrix::<f64, N, N>::zeros();
    for j in 0..N {
        for i in j..N {
            let dot: f64 = (0..j).map(|k| lower[(i, k)] * lower[(j, k)]).sum();
            let rest = block[(i, j)] - dot;
            if i == j {
                if rest.is_nan() || rest <= 0.0 {
                    return None;
                }
                lower[(j, j)] = rest.sqrt();
            } else {
                lower[(i, j)] = rest / lower[(j, j)];
            }
        }
    }
    let mut inverse_lower = SMatrix::<f64, N, N>::identity();
    lower.solve_lower_triangular_mut(&mut inverse_lower).then(|| inverse_lower.transpose() * inverse_lower)
}

fn solve_reduced<const A: usize>(
    reduced: &BTreeMap<(usize, usize), SMatrix<f64, A, A>>,
    rhs: &[SVector<f64, A>],
) -> Result<Vec<SVector<f64, A>>, SolveError> {
    let size = rhs.len() * A;
    if size == 0 {
        return Ok(Vec::new());
    }
    let triplets = lower_triplets(reduced);
    let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(size, size, &triplets)
        .map_err(|_| SolveError::NotPositiveDefinite)?;
    let factor = matrix.sp_cholesky(Side::Lower).map_err(|_| SolveError::NotPositiveDefinite)?;
    let vector = Mat::from_fn(size, 1, |row, _| rhs[row / A][row % A]);
    let solution = factor.solve(&vector);
    let finite = (0..size).all(|row| solution[(row, 0)].is_finite());
    if !finite {
        return Err(SolveError::NotPositiveDefinite);
    }
    Ok((0..rhs.len()).map(|i| SVector::from_fn(|row, _| solution[(i * A + row, 0)])).collect())
}

/// Scalars of the lower triangle from the blocks of the upper one.
fn lower_triplets<const A: usize>(
    blocks: &BTreeMap<(usize, usize), SMatrix<f64, A, A>>,
) -> Vec<Triplet<usize, usize, f64>> {
    let mut triplets = Vec::with_capacity(blocks.len() * A * A);
    for (&(i, j), block) in blocks {
        for column in 0..A {
            for row in 0..A {
                // Entry (row, column) of block (i, j) stands in the lower triangle at (j, column), (i, row).
                let (r, c) = (j * A + column, i * A + row);
                if r >= c {
                    triplets.push(Triplet::new(r, c, block[(row, column)]));
                }
            }
        }
    }
    triplets
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector, Vector2};
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};

    /// Random residuals over 3 A blocks of size 2 and 4 B blocks of size 1, and the same system densely.
    fn random_system(seed: u64) -> (NormalEquations<2, 1>, DMatrix<f64>, DVector<f64>) {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(seed);
        let mut draw = || rng.random_range(-1.0..1.0_f64);
        let mut equations = NormalEquations::<2, 1>::new(3, 4);
        let mut dense = DMatrix::zeros(10, 10);
        let mut gradient = DVector::zeros(10);
        let mut record = |row: DVector<f64>, r: f64| {
            dense += &row * row.transpose();
            gradient += &row * r;
        };
        for i in 0..3 {
            for k in 0..4 {
                for _ in 0..2 {
                    let ja = SMatrix::<f64, 1, 2>::new(draw(), draw());
                    let jb = SMatrix::<f64, 1, 1>::new(draw());
                    let r = draw();
                    equations.add(Some((i, &ja)), Some((k, &jb)), &SVector::from([r]), 1.0);
                    let mut row = DVector::zeros(10);
                    row.rows_mut(2 * i, 2).copy_from(&ja.transpose());
                    row[6 + k] = jb[0];
                    record(row, r);
                }
            }
        }
        let (ji, jj) = (SMatrix::<f64, 1, 2>::new(draw(), draw()), SMatrix::<f64, 1, 2>::new(draw(), draw()));
        let r = draw();
        equations.add_pair(Some((2, &ji)), Some((0, &jj)), &SVector::from([r]), 1.0);
        let mut row = DVector::zeros(10);
        row.rows_mut(4, 2).copy_from(&ji.transpose());
        row.rows_mut(0, 2).copy_from(&jj.transpose());
        record(row, r);
        (equations, dense, gradient)
    }

    proptest! {
        #[test]
        fn schur_complement_equals_the_dense_solution(seed in any::<u64>(), damping in 0.0..1.0_f64) {
            let (equations, mut dense, gradient) = random_system(seed);
            for i in 0..10 {
                dense[(i, i)] *= 1.0 + damping;
            }
            let expected = dense.cholesky().unwrap().solve(&-gradient);
            let step = equations.solve(damping).unwrap();
            let flat = step.a.iter().flat_map(|v| v.iter().copied()).chain(step.b.iter().map(|v| v[0]));
            let difference = (DVector::from_iterator(10, flat) - &expected).norm();
            prop_assert!(difference < 1e-6 * expected.norm().max(1.0), "{difference}");
        }
    }

    #[test]
    fn an_unobserved_block_is_an_error() {
        let mut equations = NormalEquations::<2, 1>::new(2, 1);
        let jacobian = SMatrix::<f64, 2, 2>::identity();
        equations.add_pair(Some((0, &jacobian)), None, &Vector2::zeros(), 1.0);
        assert_eq!(equations.solve(0.0), Err(SolveError::NotPositiveDefinite));
    }

    #[test]
    fn nothing_to_solve_is_an_empty_step() {
        let step = NormalEquations::<6, 3>::new(0, 0).solve(0.0).unwrap();
        assert!(step.a.is_empty() && step.b.is_empty());
    }
}
