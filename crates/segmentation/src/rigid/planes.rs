//! How planar a surface is: furniture, walls and screens are, people are not.

use pfd_geometry::DepthNoise;
use rand::RngExt;

/// Hypotheses: with a plane under a third of the points, ten of them hold three of its points with 30 %.
const HYPOTHESES: usize = 60;
/// Distance to a plane, standard deviations of depth, up to which a point lies on it.
const SIGMAS: f32 = 3.0;

/// Share of `points` (camera frame, metres) on the plane that holds most of them.
pub(crate) fn planar_share(points: &[[f32; 3]], noise: &DepthNoise, rng: &mut impl RngExt) -> f32 {
    if points.len() < 3 {
        return 0.0;
    }
    let mut most = 0;
    for _ in 0..HYPOTHESES {
        let [a, b, c] = [0; 3].map(|_| points[rng.random_range(0..points.len())]);
        let Some(normal) = normal(a, b, c) else { continue };
        let on_plane = |p: &&[f32; 3]| {
            let sigma = noise.sigma(f64::from(p[2])) as f32;
            dot(normal, difference(**p, a)).abs() < SIGMAS * sigma
        };
        most = most.max(points.iter().filter(on_plane).count());
    }
    most as f32 / points.len() as f32
}

fn normal(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> Option<[f32; 3]> {
    let (u, v) = (difference(b, a), difference(c, a));
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let length = dot(n, n).sqrt();
    (length > f32::EPSILON).then(|| n.map(|x| x / length))
}

fn difference(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    fn share(z: impl Fn(f32, f32) -> f32) -> f32 {
        let grid = (0..400).map(|i| (f32::from(i as u8 % 20) * 0.02, (i / 20) as f32 * 0.02));
        let points: Vec<[f32; 3]> = grid.map(|(x, y)| [x, y, z(x, y)]).collect();
        planar_share(&points, &DepthNoise::default(), &mut Pcg64Mcg::seed_from_u64(3))
    }

    #[test]
    fn a_slanted_plane_is_planar_and_a_body_is_not() {
        assert!(share(|x, y| 1.0 + 0.3 * x - 0.2 * y) > 0.99);
        let cylinder = |x: f32, _: f32| 1.2 - (0.04 - (x - 0.2) * (x - 0.2)).max(0.0).sqrt();
        assert!(share(cylinder) < 0.6);
    }

    #[test]
    fn too_few_points_and_points_on_a_line_are_no_plane() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        assert_eq!(planar_share(&[[0.0, 0.0, 1.0]; 2], &DepthNoise::default(), &mut rng), 0.0);
        assert_eq!(planar_share(&[[0.0, 0.0, 1.0]; 9], &DepthNoise::default(), &mut rng), 0.0);
    }
}
