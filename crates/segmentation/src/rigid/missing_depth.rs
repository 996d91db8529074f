//! Where pixels without depth lie in earlier frames: they are given a depth to be warped by.

use nalgebra::Vector3;

use super::large_planes::{Plane, Sums};
use super::objects::median;
use super::view::Pinhole;
use crate::config::MissingDepth;

/// Of this many columns and rows one each has a say in the plane.
const SPACING: usize = 8;
/// Reweighted steps of the plane fit.
const STEPS: usize = 6;
/// Scale of the loss as a share of the median inverse depth: one plane is looked for, not the mean of a room.
const SCALE: f64 = 0.1;
/// Fewest pixels that a plane is fitted to.
const MIN_PIXELS: usize = 30;

/// Copies `depth` (metres, 0 = none) with its gaps filled; 0 stays where nothing is known.
pub(crate) fn fill(camera: &Pinhole, depth: &[f32], method: MissingDepth, out: &mut Vec<f32>) {
    out.clear();
    out.extend_from_slice(depth);
    match method {
        MissingDepth::Background => fill_rows(camera.width, out),
        MissingDepth::Homography => fill_by_plane(camera, out),
    }
}

/// Fills missing depth from the farther end of each gap in a row: what shows through a gap is mostly background.
fn fill_rows(width: usize, depth: &mut [f32]) {
    for row in depth.chunks_exact_mut(width.max(1)) {
        let mut start = 0;
        while let Some(gap) = row[start..].iter().position(|&z| z == 0.0).map(|g| g + start) {
            let end = row[gap..].iter().position(|&z| z > 0.0).map_or(row.len(), |e| e + gap);
            let left = if gap > 0 { row[gap - 1] } else { 0.0 };
            let right = row.get(end).copied().unwrap_or(0.0);
            row[gap..end].fill(left.max(right));
            start = end;
        }
    }
}

/// Fills missing depth from the plane that most of the frame lies on. A rigid motion and a plane make a homography.
fn fill_by_plane(camera: &Pinhole, depth: &mut [f32]) {
    let Some(plane) = fit_plane(camera, depth) else { return };
    for (v, row) in depth.chunks_exact_mut(camera.width.max(1)).enumerate() {
        for (u, z) in row.iter_mut().enumerate().filter(|(_, z)| **z == 0.0) {
            let inverse = plane.dot(&Vector3::new(u as f64, v as f64, 1.0)) as f32;
            if inverse > 0.0 {
                *z = 1.0 / inverse;
            }
        }
    }
}

/// The plane that most of the frame lies on, over pixels `(column, row)`, by least squares with a redescending loss.
fn fit_plane(camera: &Pinhole, depth: &[f32]) -> Option<Plane> {
    let (columns, rows) = (|| (0..camera.width).step_by(SPACING), (0..camera.height).step_by(SPACING));
    let pixels = rows.flat_map(|v| columns().map(move |u| (u, v)));
    let measured = pixels.filter_map(|(u, v)| {
        let z = f64::from(depth[v * camera.width + u]);
        (z > 0.0).then(|| [u as f64, v as f64, z.recip()])
    });
    let votes: Vec<[f64; 3]> = measured.collect();
    if votes.len() < MIN_PIXELS {
        return None;
    }
    let middle = f64::from(median(&mut votes.iter().map(|[_, _, q]| *q as f32).collect::<Vec<_>>())?);
    let mut plane = Plane::new(0.0, 0.0, middle);
    for _ in 0..STEPS {
        let mut sums = Sums::default();
        for &[u, v, q] in &votes {
            let residual = (q - plane.dot(&Vector3::new(u, v, 1.0))) / (SCALE * middle);
            sums.add([u, v, q], (1.0 + residual * residual).powi(-2));
        }
        plane = sums.fit()?;
    }
    Some(plane)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 80, height: 60, fx: 70.0, fy: 70.0, cx: 39.5, cy: 29.5 };

    #[test]
    fn gaps_take_the_farther_border() {
        let mut depth = [1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        fill_rows(5, &mut depth);
        assert_eq!(depth, [1.0, 2.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    /// A wall that recedes to the right, a box before a quarter of it, and gaps, one of them through whole rows.
    #[test]
    fn gaps_lie_on_the_plane_of_the_room() {
        let wall = |i: usize| 1.0 / (0.5 - 0.002 * (i % 80) as f32);
        let measured = |i: usize| match (i % 80, i / 80) {
            (_, 20..30) | (40..50, _) => 0.0,
            (0..20, _) => 0.7,
            _ => wall(i),
        };
        let depth: Vec<f32> = (0..CAMERA.pixels()).map(measured).collect();
        let mut out = Vec::new();
        fill(&CAMERA, &depth, MissingDepth::Homography, &mut out);
        for (i, (&filled, &z)) in out.iter().zip(&depth).enumerate() {
            let expected = if z > 0.0 { z } else { wall(i) };
            assert!((filled - expected).abs() < 0.01 * expected, "pixel {i}: {filled}, not {expected}");
        }
    }

    #[test]
    fn nothing_is_made_of_nothing() {
        for method in [MissingDepth::Background, MissingDepth::Homography] {
            let mut out = vec![1.0];
            fill(&CAMERA, &vec![0.0; CAMERA.pixels()], method, &mut out);
            assert_eq!(out, vec![0.0; CAMERA.pixels()]);
        }
    }
}
