//! Large planes of a depth image: desks, walls, floors, door leaves. Each is rigid, so that it moves as a whole or not at all; and what
//! touches it connects with it by depth without being a part of it.
//!
//! The inverse depth of a plane is linear in the pixel, and its noise is nearly the same at every depth, so that planes are found by
//! least squares: on small blocks first, which then grow together (compare Proença and Gao, "Fast cylinder and plane extraction from
//! depth cameras for visual odometry", IROS 2018).

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use pfd_geometry::DepthNoise;

use super::regions::neighbours;
use super::view::Pinhole;

/// Index of pixels on no large plane.
pub(crate) const NO_PLANE: u16 = 0;

/// Side of a block, working pixels.
const BLOCK: usize = 8;
/// Share of a block's pixels that have depth at least.
const MEASURED: f64 = 0.75;
/// Root mean square of the residuals up to which a block is flat, and up to which it goes on with the plane beside it, standard
/// deviations of inverse depth: more than one, for what the sensor's calibration bends.
const FLAT: f64 = 1.25;
/// Residual up to which a pixel lies on a plane, standard deviations.
const ON_PLANE: f32 = 2.0;
/// Planes smaller than this are none, square metres: a chest is flat over less. Where noise hides the curvature of a chest, beyond one
/// metre, more is asked by the square of depth.
const MIN_AREA: f64 = 0.05;
/// Cosine of the steepest angle at which the area of a plane is taken for what its blocks say.
const MIN_COSINE: f64 = 0.1;

/// Finds large planes.
#[derive(Debug, Default)]
pub(crate) struct LargePlanes {
    /// Plane of each working pixel, from 1 on, or [`NO_PLANE`].
    pub(crate) labels: Vec<u16>,
    planes: Vec<Plane>,
    blocks: Vec<Block>,
    /// Blocks of the plane that grows.
    members: Vec<usize>,
    /// Planes of a block and of those around it.
    nearby: Vec<u16>,
}

/// Inverse depth (1/m) as a linear function of `(x, y, 1)`; here pixels are counted from the principal point.
pub(crate) type Plane = Vector3<f64>;

#[derive(Clone, Copy, Debug, Default)]
struct Block {
    sums: Sums,
    /// Whether its pixels lie on a plane.
    flat: bool,
    /// Whether a plane has tried to grow over it from within.
    taken: bool,
    /// The large plane that it belongs to.
    label: u16,
}

/// Normal equations of a plane.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sums {
    /// Lower triangle of the sum of a aᵀ with a = (x, y, 1); the last element counts the pixels.
    normal: Matrix3<f64>,
    /// Sum of a q.
    right: Vector3<f64>,
    /// Sum of q².
    squares: f64,
}

impl Sums {
    /// Adds a pixel `(x, y)` with inverse depth `q`, which counts `weight` times.
    pub(crate) fn add(&mut self, [x, y, q]: [f64; 3], weight: f64) {
        let (by_x, by_y, by_q) = (weight * x, weight * y, weight * q);
        let n = &mut self.normal;
        n.m11 += by_x * x;
        n.m21 += by_x * y;
        n.m31 += by_x;
        n.m22 += by_y * y;
        n.m32 += by_y;
        n.m33 += weight;
        self.right += Vector3::new(by_q * x, by_q * y, by_q);
        self.squares += by_q * q;
    }

    fn merge(&mut self, other: &Self) {
        self.normal += other.normal;
        self.right += other.right;
        self.squares += other.squares;
    }

    fn count(&self) -> f64 {
        self.normal[(2, 2)]
    }

    fn mean_inverse_depth(&self) -> f64 {
        self.right[2] / self.count()
    }

    /// The plane; `None` where the pixels lie on a line.
    pub(crate) fn fit(&self) -> Option<Plane> {
        Some(self.normal.cholesky()?.solve(&self.right))
    }

    /// Whether the pixels lie on a plane.
    fn lie_on(&self, plane: &Plane, noise: &DepthNoise) -> bool {
        let mut product = Vector3::zeros();
        product.sygemv(1.0, &self.normal, plane, 0.0);
        let squares = self.squares - 2.0 * plane.dot(&self.right) + plane.dot(&product);
        let q = self.mean_inverse_depth();
        // Of both parts of the noise the larger: together they would let a belly pass for flat at arm's length.
        let sigma = FLAT * noise.quadratic.max(noise.offset * q * q);
        squares < sigma * sigma * self.count()
    }

    /// Area of the plane that the pixels cover, square metres.
    fn area(&self, plane: &Plane, camera: &Pinhole) -> f64 {
        let (fx, fy, q) = (f64::from(camera.fx), f64::from(camera.fy), self.mean_inverse_depth());
        let normal = Vector3::new(plane[0] * fx, plane[1] * fy, plane[2]);
        let [x, y] = [0, 1].map(|axis| self.normal[(2, axis)] / self.count());
        let ray = Vector3::new(x / fx, y / fy, 1.0);
        let cosine = normal.dot(&ray).abs() / (normal.norm() * ray.norm());
        self.count() / (fx * fy * q * q * cosine.max(MIN_COSINE))
    }
}

impl LargePlanes {
    /// Forgets all planes; `pixels` pixels.
    pub(crate) fn clear(&mut self, pixels: usize) {
        self.labels.clear();
        self.labels.resize(pixels, NO_PLANE);
    }

    /// Finds the planes of a depth image (metres, 0 = none).
    pub(crate) fn find(&mut self, camera: &Pinhole, noise: &DepthNoise, depth: &[f32]) {
        self.clear(depth.len());
        let size = (camera.width.div_ceil(BLOCK), camera.height.div_ceil(BLOCK));
        self.measure_blocks(camera, noise, depth, size);
        self.planes.clear();
        for seed in 0..self.blocks.len() {
            if self.blocks[seed].flat && !self.blocks[seed].taken {
                self.grow(seed, camera, noise, size);
            }
        }
        for block in 0..self.blocks.len() {
            self.assign(block, camera, noise, depth, size);
        }
    }

    fn measure_blocks(&mut self, camera: &Pinhole, noise: &DepthNoise, depth: &[f32], size: (usize, usize)) {
        self.blocks.clear();
        self.blocks.extend((0..size.0 * size.1).map(|block| {
            let mut sums = Sums::default();
            for (i, [x, y]) in pixels(camera, block, size.0) {
                if depth[i] > 0.0 {
                    sums.add([f64::from(x), f64::from(y), 1.0 / f64::from(depth[i])], 1.0);
                }
            }
            let measured = sums.count() >= MEASURED * (BLOCK * BLOCK) as f64;
            let flat = measured && sums.fit().is_some_and(|plane| sums.lie_on(&plane, noise));
            Block { sums, flat, taken: false, label: NO_PLANE }
        }));
    }

    /// Grows a plane from a block over its neighbours, and keeps it if it is large.
    fn grow(&mut self, seed: usize, camera: &Pinhole, noise: &DepthNoise, size: (usize, usize)) {
        let mut sums = self.blocks[seed].sums;
        let Some(mut plane) = sums.fit() else { return };
        let mut area = sums.area(&plane, camera);
        self.blocks[seed].taken = true;
        self.members.clear();
        self.members.push(seed);
        let mut next = 0;
        while let Some(&member) = self.members.get(next) {
            next += 1;
            for i in neighbours(size, member).into_iter().flatten() {
                let block = &mut self.blocks[i];
                if block.flat && !block.taken && block.sums.lie_on(&plane, noise) {
                    block.taken = true;
                    self.members.push(i);
                    sums.merge(&block.sums);
                    plane = sums.fit().unwrap_or(plane);
                    area += block.sums.area(&plane, camera);
                }
            }
        }
        let depth = 1.0 / sums.mean_inverse_depth();
        if area >= MIN_AREA * depth.max(1.0).powi(2) {
            self.planes.push(plane);
            for &member in &self.members {
                self.blocks[member].label = self.planes.len() as u16;
            }
        }
    }

    /// Labels the pixels of a block that lie on its plane or on one beside it.
    fn assign(
        &mut self,
        block: usize,
        camera: &Pinhole,
        noise: &DepthNoise,
        depth: &[f32],
        (columns, rows): (usize, usize),
    ) {
        self.nearby.clear();
        self.nearby.push(self.blocks[block].label);
        for v in around(block / columns, rows) {
            self.nearby.extend(around(block % columns, columns).map(|u| self.blocks[v * columns + u].label));
        }
        self.nearby.retain(|label| *label != NO_PLANE);
        self.nearby.dedup();
        if self.nearby.is_empty() {
            return;
        }
        for (i, [x, y]) in pixels(camera, block, columns).filter(|&(i, _)| depth[i] > 0.0) {
            let q = 1.0 / depth[i];
            let limit = ON_PLANE * (noise.quadratic as f32 + noise.offset as f32 * q * q);
            let lies_on = |label: &&u16| {
                let p = self.planes[**label as usize - 1].map(|a| a as f32);
                (p[0] * x + p[1] * y + p[2] - q).abs() < limit
            };
            self.labels[i] = self.nearby.iter().find(lies_on).copied().unwrap_or(NO_PLANE);
        }
    }
}

/// A position and those beside it.
fn around(position: usize, size: usize) -> Range<usize> {
    position.saturating_sub(1)..(position + 2).min(size)
}

/// The pixels of a block, each with its coordinates from the principal point.
fn pixels(camera: &Pinhole, block: usize, columns: usize) -> impl Iterator<Item = (usize, [f32; 2])> + use<> {
    let &Pinhole { width, height, cx, cy, .. } = camera;
    let (left, top) = (block % columns * BLOCK, block / columns * BLOCK);
    let (right, bottom) = ((left + BLOCK).min(width), (top + BLOCK).min(height));
    let row = move |v: usize| (left..right).map(move |u| (v * width + u, [u as f32 - cx, v as f32 - cy]));
    (top..bottom).flat_map(row)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 160, height: 124, fx: 131.0, fy: 131.0, cx: 79.5, cy: 61.5 };

    /// Planes of a scene of which `depth` is the depth along the ray (x, y, 1).
    fn found(depth: impl Fn(f32, f32) -> f32) -> LargePlanes {
        let depth_of = |i: usize| {
            let [x, y] = CAMERA.ray(i);
            depth(x, y)
        };
        let depth: Vec<f32> = (0..CAMERA.pixels()).map(depth_of).collect();
        let mut planes = LargePlanes::default();
        planes.find(&CAMERA, &DepthNoise::default(), &depth);
        planes
    }

    fn at(planes: &LargePlanes, u: usize, v: usize) -> u16 {
        planes.labels[v * CAMERA.width + u]
    }

    #[test]
    fn a_wall_and_the_floor_are_two_planes_that_meet_at_their_edge() {
        // The wall is 2 m away, the floor 0.6 m below the camera: they meet at y = 0.3, row 101.
        let planes = found(|_, y| if y > 0.3 { 0.6 / y } else { 2.0 });
        let (wall, floor) = (at(&planes, 80, 10), at(&planes, 80, 120));
        assert!(wall != NO_PLANE && floor != NO_PLANE && wall != floor, "{wall} {floor}");
        assert!((0..100).all(|v| at(&planes, 20, v) == wall));
        assert!((103..124).all(|v| at(&planes, 20, v) == floor), "the last rows are half a block");
    }

    #[test]
    fn what_stands_on_a_plane_is_no_part_of_it() {
        // A box of 20 x 20 x 10 cm on a table, seen from above.
        let planes = found(|x, y| if x.abs() < 0.14 && y.abs() < 0.14 { 0.7 } else { 0.8 });
        assert_ne!(at(&planes, 10, 10), NO_PLANE);
        assert_eq!(at(&planes, 10, 10), at(&planes, 150, 110));
        assert_eq!(at(&planes, 80, 62), NO_PLANE, "its top is flat, and too small");
    }

    #[test]
    fn a_body_is_no_plane() {
        // An ellipsoid 36 cm wide, 24 deep and 70 high, 1 m and 2 m away.
        for distance in [1.0, 2.0] {
            let body = |x: f32, y: f32| {
                let (a, b, c) = (x / 0.18, y / 0.35, 1.0 / 0.12);
                let (p, q) = (a * a + b * b + c * c, distance * c * c);
                let root = q * q - p * (distance * distance * c * c - 1.0);
                if root > 0.0 { (q - root.sqrt()) / p } else { 0.0 }
            };
            let planes = found(body);
            assert!(planes.labels.iter().all(|l| *l == NO_PLANE), "{distance} m");
        }
    }

    #[test]
    fn nothing_is_found_where_nothing_is_measured() {
        assert!(found(|_, _| 0.0).labels.iter().all(|l| *l == NO_PLANE));
    }
}
