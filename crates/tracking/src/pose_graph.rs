//! Pose graph: keyframes joined by relative poses (Grisetti et al., "A tutorial on graph-based SLAM", 2010).

use nalgebra::{Matrix6, Vector6};
use pfd_geometry::{Pose, pose};
use pfd_optimization::{LeastSquares, NormalEquations, Options, Step, Summary, minimize};

/// A measured relative pose.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(non_snake_case)]
pub struct Edge {
    /// Index of a node.
    pub a: usize,
    /// Index of another node.
    pub b: usize,
    /// `T_a_world · T_b_world⁻¹` as measured.
    pub T_a_b: Pose,
    /// Information relative to other edges, such as the number of shared points.
    pub weight: f64,
}

/// Nodes are world-to-camera poses; node 0 is held fixed.
#[derive(Clone, Debug)]
pub struct PoseGraph {
    /// World to camera.
    pub poses: Vec<Pose>,
    /// Relative poses.
    pub edges: Vec<Edge>,
}

/// Parameters of a pose. There are no second-kind blocks, their size is arbitrary.
const POSE: usize = 6;
const UNUSED: usize = 1;

impl PoseGraph {
    /// Moves all nodes but the first to where the edges agree best.
    pub fn optimize(&mut self) -> Summary {
        minimize(self, &Options { max_iterations: 30, ..Options::default() })
    }

    /// `log(T_a_b⁻¹ · T_a · T_b⁻¹)`: zero when the edge agrees with its nodes.
    fn residual(&self, edge: &Edge) -> Vector6<f64> {
        pose::log(&(edge.T_a_b.inverse() * self.poses[edge.a] * self.poses[edge.b].inverse()))
    }
}

/// The parameter block of a node; none for the fixed one.
fn block(node: usize, jacobian: &Matrix6<f64>) -> Option<(usize, &Matrix6<f64>)> {
    node.checked_sub(1).map(|index| (index, jacobian))
}

impl LeastSquares<POSE, UNUSED> for PoseGraph {
    fn sizes(&self) -> (usize, usize) {
        (self.poses.len().saturating_sub(1), 0)
    }

    /// With left perturbations the residual is `log(exp(Ad(T_a_b⁻¹)·ξ_a) · exp(r) · exp(-ξ_b))`; the inverse Jacobians of the
    /// exponential are taken to first order in `r`.
    fn linearize(&self, equations: &mut NormalEquations<POSE, UNUSED>) {
        for edge in &self.edges {
            let residual = self.residual(edge);
            let half_bracket = pose::lie_bracket(&residual) * 0.5;
            let by_a = (Matrix6::identity() - half_bracket) * pose::adjoint(&edge.T_a_b.inverse());
            let by_b = -(Matrix6::identity() + half_bracket);
            equations.add_pair(block(edge.a, &by_a), block(edge.b, &by_b), &residual, edge.weight);
        }
    }

    fn cost(&self) -> f64 {
        self.edges.iter().map(|edge| edge.weight * self.residual(edge).norm_squared()).sum()
    }

    fn apply(&mut self, step: &Step<POSE, UNUSED>) {
        for (pose, delta) in self.poses.iter_mut().skip(1).zip(&step.a) {
            *pose = pose::exp(delta) * *pose;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A circle of twelve cameras whose odometry turns too far each step, closed by one exact edge.
    #[test]
    fn a_closed_loop_spreads_the_error() {
        let count = 12;
        let turn = std::f64::consts::TAU / count as f64;
        let truth: Vec<Pose> = (0..count)
            .map(|i| {
                let to_world = pose::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, turn * i as f64, 0.0))
                    * pose::exp(&Vector6::new(0.0, 0.0, 1.0, 0.0, 0.0, 0.0));
                to_world.inverse()
            })
            .collect();
        let drift = pose::exp(&Vector6::new(0.01, 0.0, 0.005, 0.0, 0.004, 0.002));
        let mut graph = PoseGraph { poses: vec![truth[0]], edges: Vec::new() };
        for i in 1..count {
            let measured = truth[i - 1] * truth[i].inverse() * drift;
            graph.edges.push(Edge { a: i - 1, b: i, T_a_b: measured, weight: 1.0 });
            let last = graph.poses[i - 1];
            graph.poses.push(measured.inverse() * last);
        }
        let error = |graph: &PoseGraph| pose::log(&(graph.poses[count - 1] * truth[count - 1].inverse())).norm();
        let open = error(&graph);
        let closing = truth[count - 1] * truth[0].inverse();
        graph.edges.push(Edge { a: count - 1, b: 0, T_a_b: closing, weight: 100.0 });
        let summary = graph.optimize();
        assert!(error(&graph) < 0.02 * open, "{} of {open}", error(&graph));
        assert!(summary.final_cost < 0.2 * summary.initial_cost);
    }
}
