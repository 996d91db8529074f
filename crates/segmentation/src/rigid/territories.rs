//! Which corner speaks for which pixels, and which corners move together.
//!
//! Each corner owns the part of its surface that is nearer to it, along the surface, than to any other corner: its cell of the geodesic
//! Voronoi diagram. Corners that leave the camera motion in the same way, side by side, are a mover, and evidence over their territories
//! finds all of it in two frames. The still corners around it hold theirs: a mover that touches a desk does not take it along.

use pfd_geometry::DepthNoise;

use super::continuity::Continuity;
use super::disjoint_sets::{join, root};
use super::motion::CornerMove;
use super::objects::quantile;
use super::view::{Pinhole, ViewFrame};

/// Side of a cell of the grid on which distances are measured, working pixels.
const CELL: usize = 2;
/// Reach of a corner, cells: two corner spacings.
const REACH: f32 = 16.0;
/// What a difference of one grey level adds to a step of one cell.
const PER_LEVEL: f32 = 0.05;
/// A corner on an outline belongs to the nearest surface within so many cells: what is in front owns the outline, …
const OUTLINE: usize = 2;
/// … if it is nearer by this share.
const IN_FRONT: f32 = 0.05;
/// Pairs of scans that measure distances; each turn of a path against both scan directions takes another.
const SCANS: usize = 2;

/// Share of the corners that fit the camera motion best, hardly ever movers, …
const BEST: f32 = 0.25;
/// … and how far off, in standard deviations, such a share of normally distributed places lies: √(-2 ln (1 - [`BEST`])).
const BEST_QUANTILE: f32 = 0.76;
/// Corners on outlines, and those that a rolling shutter displaces, lie so many times farther off than the best ones suggest.
const TAIL: f32 = 2.5;
/// Least standard deviation of a corner's place, working pixels: none is found better.
const LEAST_SIGMA: f32 = 0.2;
/// Standard deviations of its place in the image from which a corner may belong to a mover. Depth has no say: on an outline it is often
/// that of the other side.
const MOVES_SIGMAS: f32 = 2.5;
/// Corners side by side that make a mover at least.
const MIN_GROUP: u32 = 4;
/// Residuals of neighbours on one mover differ by no more than this, working pixels, …
const SPREAD: f32 = 0.5;
/// … and this share of the larger one: a mover may turn.
const RELATIVE_SPREAD: f32 = 0.5;
/// How many territories deep the still corners around a mover are asked.
const RINGS: usize = 4;

const NOBODY: u16 = u16::MAX;

/// What a corner says about its territory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Nothing.
    #[default]
    Silent,
    /// It moves, together with its neighbours.
    Moving,
    /// It stands still beside a mover.
    Still,
}

/// The parts of the view, by the corner that owns them.
#[derive(Debug, Default)]
pub(crate) struct Territories {
    size: (usize, usize),
    depth: Vec<f32>,
    gray: Vec<u8>,
    owners: Vec<u16>,
    distances: Vec<f32>,
    /// Pairs of corners whose territories touch in the image, across depth edges as well; smaller index first.
    borders: Vec<(u16, u16)>,
}

impl Territories {
    /// Divides the view among the corners. Those that had no depth own no surface, but bound what others own where depth is missing.
    pub(crate) fn divide(&mut self, camera: &Pinhole, noise: &DepthNoise, frame: &ViewFrame, corners: &[CornerMove]) {
        self.load(camera, frame);
        let cells = self.depth.len();
        self.owners.clear();
        self.owners.resize(cells, NOBODY);
        self.distances.clear();
        self.distances.resize(cells, REACH);
        for (k, corner) in corners.iter().enumerate().take(NOBODY as usize) {
            if let Some(seat) = self.seat(camera, corner) {
                (self.owners[seat], self.distances[seat]) = (k as u16, 0.0);
            }
        }
        self.measure(Continuity::new(noise, CELL));
        self.find_borders();
    }

    /// What each corner says; `sigma`: of a still corner's place, pixels.
    pub(crate) fn verdicts(&self, corners: &[CornerMove], sigma: f32) -> Vec<Verdict> {
        let moves = |k: u16| moves(&corners[k as usize], sigma);
        let mut groups: Vec<u32> = (0..corners.len() as u32).collect();
        for &(a, b) in self.borders.iter().filter(|(a, b)| moves(*a) && moves(*b)) {
            if move_alike(&corners[a as usize], &corners[b as usize]) {
                join(&mut groups, a.into(), b.into());
            }
        }
        let movers: Vec<usize> = (0..corners.len()).filter(|&k| moves(k as u16)).collect();
        let mut sizes = vec![0_u32; corners.len()];
        for &k in &movers {
            sizes[root(&mut groups, k as u32) as usize] += 1;
        }
        let mut verdicts = vec![Verdict::Silent; corners.len()];
        for &k in &movers {
            if sizes[root(&mut groups, k as u32) as usize] >= MIN_GROUP {
                verdicts[k] = Verdict::Moving;
            }
        }
        self.ask_around(&mut verdicts, |k| corners[k as usize].chi2.is_some() && !moves(k));
        verdicts
    }

    /// Each cell's owner, if any, and working pixels.
    pub(crate) fn owned<'a>(&'a self, camera: &'a Pinhole) -> impl Iterator<Item = (usize, [usize; CELL * CELL])> + 'a {
        let width = camera.width;
        let rows = self.owners.chunks_exact(self.size.0.max(1)).enumerate();
        let cells = rows.flat_map(|(v, row)| row.iter().enumerate().map(move |(u, owner)| (u, v, *owner)));
        cells.filter(|(_, _, owner)| *owner != NOBODY).map(move |(u, v, owner)| {
            let first = v * CELL * width + u * CELL;
            (owner as usize, std::array::from_fn(|k| first + k / CELL * width + k % CELL))
        })
    }

    fn load(&mut self, camera: &Pinhole, frame: &ViewFrame) {
        self.size = (camera.width / CELL, camera.height / CELL);
        self.depth.clear();
        self.gray.clear();
        for v in 0..self.size.1 {
            let row = (0..self.size.0).map(|u| v * CELL * camera.width + u * CELL);
            self.depth.extend(row.clone().map(|i| frame.depth.pixels()[i]));
            self.gray.extend(row.map(|i| frame.gray.pixels()[i]));
        }
    }

    /// The cell from which a corner's territory grows.
    fn seat(&self, camera: &Pinhole, corner: &CornerMove) -> Option<usize> {
        let (columns, rows) = self.size;
        let (u, v) = (corner.to % camera.width / CELL, corner.to / camera.width / CELL);
        if u >= columns || v >= rows {
            return None;
        }
        let mut seat = v * columns + u;
        if corner.chi2.is_none() {
            return (self.depth[seat] == 0.0).then_some(seat);
        }
        for y in v.saturating_sub(OUTLINE)..(v + OUTLINE + 1).min(rows) {
            for cell in (u.saturating_sub(OUTLINE)..(u + OUTLINE + 1).min(columns)).map(|x| y * columns + x) {
                let (there, here) = (self.depth[cell], self.depth[seat]);
                if there > 0.0 && (here == 0.0 || there < (1.0 - IN_FRONT) * here) {
                    seat = cell;
                }
            }
        }
        Some(seat)
    }

    /// Distances along the surface by raster scans (see [`super::undecided`]).
    fn measure(&mut self, continuity: Continuity) {
        let (columns, cells) = (self.size.0, self.depth.len());
        let mut ways = Ways {
            depth: &self.depth,
            gray: &self.gray,
            owners: &mut self.owners,
            distances: &mut self.distances,
            continuity,
        };
        for _ in 0..SCANS {
            for first in (0..cells).step_by(columns.max(1)) {
                for i in first..first + columns {
                    if i > first {
                        ways.relax(i, i - 1);
                    }
                    if i >= columns {
                        ways.relax(i, i - columns);
                    }
                }
            }
            for first in (0..cells).step_by(columns.max(1)).rev() {
                for i in (first..first + columns).rev() {
                    if i + 1 < first + columns {
                        ways.relax(i, i + 1);
                    }
                    if i + columns < cells {
                        ways.relax(i, i + columns);
                    }
                }
            }
        }
    }

    fn find_borders(&mut self) {
        let columns = self.size.0;
        self.borders.clear();
        for (i, &owner) in self.owners.iter().enumerate() {
            let right = if (i + 1) % columns > 0 { i + 1 } else { i };
            for j in [right, i + columns].into_iter().filter(|&j| j < self.owners.len()) {
                let other = self.owners[j];
                if owner != other && owner != NOBODY && other != NOBODY {
                    self.borders.push((owner.min(other), owner.max(other)));
                }
            }
        }
        self.borders.sort_unstable();
        self.borders.dedup();
    }

    /// Lets the still corners around movers speak.
    fn ask_around(&self, verdicts: &mut [Verdict], is_still: impl Fn(u16) -> bool) {
        for _ in 0..RINGS {
            let ring: Vec<u16> = self
                .borders
                .iter()
                .flat_map(|&(a, b)| [(a, b), (b, a)])
                .filter(|&(from, to)| verdicts[from as usize] != Verdict::Silent && is_still(to))
                .map(|(_, to)| to)
                .collect();
            for k in ring {
                if verdicts[k as usize] == Verdict::Silent {
                    verdicts[k as usize] = Verdict::Still;
                }
            }
        }
    }
}

/// The shortest ways to a corner found so far.
struct Ways<'a> {
    depth: &'a [f32],
    gray: &'a [u8],
    owners: &'a mut [u16],
    distances: &'a mut [f32],
    continuity: Continuity,
}

impl Ways<'_> {
    /// Gives cell `i` to the owner of its neighbour `from` if the way through that is shorter.
    #[inline]
    fn relax(&mut self, i: usize, from: usize) {
        let through = self.distances[from] + 1.0;
        let shorter = self.owners[from] != NOBODY && through < self.distances[i];
        if !shorter || !self.connects(self.depth[i], self.depth[from]) {
            return;
        }
        let through = through + PER_LEVEL * f32::from(self.gray[i].abs_diff(self.gray[from]));
        if through < self.distances[i] {
            (self.owners[i], self.distances[i]) = (self.owners[from], through);
        }
    }

    /// Whether two cells may lie on one surface: where depth is missing in both nothing speaks against it.
    #[inline]
    fn connects(&self, a: f32, b: f32) -> bool {
        (a == 0.0 && b == 0.0) || self.continuity.connects(a, b)
    }
}

/// Standard deviation of a still corner's place, working pixels, as those have it that fit the camera motion best, `expected` at most. A
/// slow camera shows a slow mover.
pub(crate) fn corner_sigma(corners: &[CornerMove], expected: f32) -> f32 {
    let with_depth = corners.iter().filter(|corner| corner.chi2.is_some());
    let mut errors: Vec<f32> = with_depth.map(|corner| corner.residual[0].hypot(corner.residual[1])).collect();
    let measured = quantile(&mut errors, BEST).map_or(f32::INFINITY, |error| TAIL * error / BEST_QUANTILE);
    measured.max(LEAST_SIGMA).min(expected)
}

/// Whether enough corners leave the camera motion that some may be a mover; `sigma` as in [`Territories::verdicts`].
pub(crate) fn enough_move(corners: &[CornerMove], sigma: f32) -> bool {
    corners.iter().filter(|corner| moves(corner, sigma)).count() >= MIN_GROUP as usize
}

fn moves(&CornerMove { residual: [x, y], slide, chi2, .. }: &CornerMove, sigma: f32) -> bool {
    chi2.is_some() && x.hypot(y) > MOVES_SIGMAS * sigma + slide
}

fn move_alike(a: &CornerMove, b: &CornerMove) -> bool {
    let length = |[x, y]: [f32; 2]| x.hypot(y);
    let difference = length([a.residual[0] - b.residual[0], a.residual[1] - b.residual[1]]);
    difference < SPREAD + RELATIVE_SPREAD * length(a.residual).max(length(b.residual))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    const CAMERA: Pinhole = Pinhole { width: 80, height: 16, fx: 80.0, fy: 80.0, cx: 39.5, cy: 7.5 };

    /// A wall at 2 m; from column 40 on something at 1 m.
    fn frame() -> ViewFrame {
        let mut frame = ViewFrame { gray: Image::filled(80, 16, 90), depth: Image::filled(80, 16, 2.0) };
        for v in 0..16 {
            (40..80).for_each(|u| frame.depth[(u, v)] = 1.0);
        }
        frame
    }

    fn corner(u: usize, residual: [f32; 2]) -> CornerMove {
        let to = 8 * CAMERA.width + u;
        let chi2 = Some(100.0 * residual[0].hypot(residual[1]));
        CornerMove { from: to, to, displacement: residual, residual, slide: 0.0, chi2 }
    }

    fn verdicts(corners: &[CornerMove]) -> (Territories, Vec<Verdict>) {
        let mut territories = Territories::default();
        territories.divide(&CAMERA, &DepthNoise::default(), &frame(), corners);
        let verdicts = territories.verdicts(corners, 0.4);
        (territories, verdicts)
    }

    #[test]
    fn territories_end_at_depth_edges_and_halfway() {
        let (territories, _) = verdicts(&[corner(10, [0.0; 2]), corner(30, [0.0; 2]), corner(60, [0.0; 2])]);
        let owner = |u: usize| {
            territories.owned(&CAMERA).find(|(_, cell)| cell.contains(&(8 * CAMERA.width + u))).map(|(k, _)| k)
        };
        assert_eq!([2, 18, 24, 38, 42, 70].map(owner), [Some(0), Some(0), Some(1), Some(1), Some(2), Some(2)]);
        assert_eq!(territories.borders, [(0, 1), (1, 2)]);
    }

    #[test]
    fn where_depth_is_missing_a_corner_that_had_some_owns_what_no_other_does() {
        let mut frame = frame();
        for v in 0..16 {
            (40..80).for_each(|u| frame.depth[(u, v)] = 0.0);
        }
        let unknown = CornerMove { chi2: None, ..corner(70, [3.0, 0.0]) };
        let corners = [corner(10, [0.0; 2]), corner(50, [3.0, 0.0]), unknown];
        let mut territories = Territories::default();
        territories.divide(&CAMERA, &DepthNoise::default(), &frame, &corners);
        let owner = |u: usize| {
            territories.owned(&CAMERA).find(|(_, cell)| cell.contains(&(8 * CAMERA.width + u))).map(|(k, _)| k)
        };
        assert_eq!([30, 42, 56, 64].map(owner), [Some(0), Some(1), Some(1), Some(2)]);
        let still = territories.verdicts(&[corner(10, [0.0; 2]), corner(50, [0.0; 2]), unknown], 0.4);
        assert!(still.iter().all(|v| *v == Verdict::Silent));
    }

    #[test]
    fn corners_are_as_precise_as_those_that_fit_best_and_no_worse_than_expected() {
        let with_errors = |error: f32| [&[corner(10, [error, 0.0]); 6][..], &[corner(60, [9.0, 0.0]); 14]].concat();
        let sigma = |error| corner_sigma(&with_errors(error), 0.7);
        assert_eq!(sigma(0.0), LEAST_SIGMA);
        assert!((sigma(0.1) - 0.1 * TAIL / BEST_QUANTILE).abs() < 1e-6);
        assert_eq!(sigma(0.5), 0.7, "as much as the image motion lets expect");
        let unknown = CornerMove { chi2: None, ..corner(10, [0.1, 0.0]) };
        assert_eq!(corner_sigma(&[unknown; 20], 0.7), 0.7, "a corner without depth has no error");
    }

    #[test]
    fn an_outline_belongs_to_what_is_in_front() {
        let (territories, _) = verdicts(&[corner(38, [0.0; 2])]);
        assert!(territories.owned(&CAMERA).all(|(_, cell)| cell.iter().all(|i| i % CAMERA.width >= 40)));
    }

    #[test]
    fn neighbours_that_move_alike_are_a_mover_and_still_ones_beside_them_object() {
        use Verdict::{Moving, Silent, Still};
        let right = [2.0, 0.0];
        let four = [44, 50, 56, 62].map(|u| corner(u, right));
        let beside = [corner(70, [0.0; 2]), corner(30, [0.0; 2])];
        let (_, found) = verdicts(&[&four[..], &beside].concat());
        assert_eq!(found, [Moving, Moving, Moving, Moving, Still, Still]);
        let (_, found) = verdicts(&[&four[..], &[corner(4, [0.0; 2])]].concat());
        assert_eq!(found[4], Silent, "not beside them");
        let sliding = four.map(|c| CornerMove { slide: 1.5, ..c });
        let (_, found) = verdicts(&[&sliding[..], &beside].concat());
        assert!(found.iter().all(|v| *v == Silent), "a depth edge takes them along");
        let (_, three) = verdicts(&[&four[1..], &beside].concat());
        assert!(three.iter().all(|v| *v == Silent));
        let scattered = [(44, [2.0, 0.0]), (50, [-2.0, 0.0]), (56, [0.0, 2.0]), (62, [0.0, -2.0])];
        let (_, found) = verdicts(&scattered.map(|(u, r)| corner(u, r)));
        assert!(found.iter().all(|v| *v == Silent), "noise has no common direction");
    }
}
