//! Grey levels around a pixel: what lies there to within the uncertainty of a warp.

use super::view::Pinhole;

/// Darkest and brightest of pixel `i` and its eight neighbours, where `luma` knows them.
pub(crate) fn range(camera: &Pinhole, i: usize, luma: impl Fn(usize) -> Option<f32>) -> Option<[f32; 2]> {
    let (u, v) = (i % camera.width, i / camera.width);
    let rows = v.saturating_sub(1)..(v + 2).min(camera.height);
    let columns = u.saturating_sub(1)..(u + 2).min(camera.width);
    let around = rows.flat_map(|y| columns.clone().map(move |x| y * camera.width + x));
    around.filter_map(luma).fold(None, |range, g| {
        let [low, high] = range.unwrap_or([g; 2]);
        Some([g.min(low), g.max(high)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 4, height: 3, fx: 4.0, fy: 4.0, cx: 1.5, cy: 1.0 };

    #[test]
    fn the_range_is_that_of_the_known_neighbours_in_the_image() {
        let luma = |i: usize| (i != 6).then_some(i as f32);
        assert_eq!(range(&CAMERA, 5, luma), Some([0.0, 10.0]));
        assert_eq!(range(&CAMERA, 3, luma), Some([2.0, 7.0]), "not the first of the next row");
        assert_eq!(range(&CAMERA, 11, |i| (i == 6).then_some(7.0)), Some([7.0, 7.0]));
        assert_eq!(range(&CAMERA, 11, |_| None), None);
    }
}
