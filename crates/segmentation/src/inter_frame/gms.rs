//! Grid-based motion statistics: keeps a match when enough neighbouring matches move the same way (Bian et al., CVPR 2017).
//!
//! A true match has others beside it that land beside it; a false one has none. Both images are divided into cells; the
//! matches from the nine cells around a match's cell to the nine cells around its partner's cell are counted and compared with
//! `α √n` (eq. 15), `n` being the mean number of features in those nine cells. Rotation permutes the outer eight cells
//! (section 3.3), scale changes the cell size of the second image.

/// Cells per side of the first image (section 3.2: 20 × 20).
const CELLS: usize = 20;
/// α of eq. 15.
const THRESHOLD: f64 = 6.0;
/// Relative cell sizes of the second image that are tried for scale changes.
const SCALES: [f64; 5] = [1.0, 0.5, std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::SQRT_2, 2.0];
/// The outer cells of a 3×3 block in the order of a turn; the centre comes last.
const RING: [(i32, i32); 9] = [(-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (0, 0)];

/// Which changes between the images are tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GmsOptions {
    /// Turns by multiples of 45°.
    pub rotation: bool,
    /// Scale changes between 1/2 and 2.
    pub scale: bool,
}

/// For each pair of positions whether it is a true match; sizes are (width, height) of the images, pixels.
pub fn filter(a: &[[f32; 2]], b: &[[f32; 2]], sizes: [(usize, usize); 2], options: GmsOptions) -> Vec<bool> {
    let scales = if options.scale { &SCALES[..] } else { &SCALES[..1] };
    let turns = if options.rotation { 8 } else { 1 };
    let count = |kept: &[bool]| kept.iter().filter(|k| **k).count();
    let mut best = vec![false; a.len().min(b.len())];
    for &scale in scales {
        let cells = ((CELLS as f64 * scale).round() as usize).max(1);
        for kept in filter_at_scale(a, b, sizes, cells, turns) {
            if count(&kept) > count(&best) {
                best = kept;
            }
        }
    }
    best
}

/// The matches that survive each turn at one scale: those that do in any of the four shifted grids (section 3.2, "multi-grid").
fn filter_at_scale(
    a: &[[f32; 2]],
    b: &[[f32; 2]],
    sizes: [(usize, usize); 2],
    cells: usize,
    turns: usize,
) -> Vec<Vec<bool>> {
    let mut kept = vec![vec![false; a.len().min(b.len())]; turns];
    let second = Grid { cells, size: sizes[1], shift: [0.0; 2] };
    let to: Vec<usize> = b.iter().map(|&p| second.cell(p)).collect();
    for shift in [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]] {
        let first = Grid { cells: CELLS, size: sizes[0], shift };
        let from: Vec<usize> = a.iter().map(|&p| first.cell(p)).collect();
        let statistics = Statistics::count(&from, &to, &first, &second);
        for (turn, kept) in kept.iter_mut().enumerate() {
            let partner = statistics.partners(turn);
            for (kept, (i, j)) in kept.iter_mut().zip(from.iter().zip(&to)) {
                *kept |= partner[*i] == Some(*j);
            }
        }
    }
    kept
}

/// A division of an image into cells; a grid that is shifted, by a part of a cell, has one more row or column.
struct Grid {
    cells: usize,
    size: (usize, usize),
    shift: [f32; 2],
}

impl Grid {
    /// Columns and rows.
    fn sides(&self) -> [usize; 2] {
        self.shift.map(|shift| self.cells + usize::from(shift > 0.0))
    }

    /// Number of cells.
    fn count(&self) -> usize {
        let [columns, rows] = self.sides();
        columns * rows
    }

    fn cell(&self, [x, y]: [f32; 2]) -> usize {
        let sides = self.sides();
        let index = |axis: usize, value: f32, size: usize| {
            let cell = value / size.max(1) as f32 * self.cells as f32 + self.shift[axis];
            (cell.max(0.0) as usize).min(sides[axis] - 1)
        };
        index(1, y, self.size.1) * sides[0] + index(0, x, self.size.0)
    }

    fn neighbour(&self, cell: usize, (dx, dy): (i32, i32)) -> Option<usize> {
        let [columns, rows] = self.sides().map(|side| side as i32);
        let (x, y) = (cell as i32 % columns + dx, cell as i32 / columns + dy);
        ((0..columns).contains(&x) && (0..rows).contains(&y)).then(|| (y * columns + x) as usize)
    }
}

/// Matches between cells.
struct Statistics<'a> {
    first: &'a Grid,
    second: &'a Grid,
    /// Features in each cell of the first image.
    features: Vec<u32>,
    /// Matches from cell `i` to cell `j`, at `i * columns + j`.
    matches: Vec<u16>,
    columns: usize,
}

impl<'a> Statistics<'a> {
    fn count(from: &[usize], to: &[usize], first: &'a Grid, second: &'a Grid) -> Self {
        let (rows, columns) = (first.count(), second.count());
        let (mut features, mut matches) = (vec![0; rows], vec![0_u16; rows * columns]);
        for (&i, &j) in from.iter().zip(to) {
            features[i] += 1;
            let count = &mut matches[i * columns + j];
            *count = count.saturating_add(1);
        }
        Self { first, second, features, matches, columns }
    }

    /// For each cell of the first image the cell of the second that its true matches lead to.
    fn partners(&self, turn: usize) -> Vec<Option<usize>> {
        (0..self.features.len()).map(|i| self.partner(i, turn)).collect()
    }

    fn partner(&self, i: usize, turn: usize) -> Option<usize> {
        let row = &self.matches[i * self.columns..(i + 1) * self.columns];
        let (j, &most) = row.iter().enumerate().max_by_key(|&(_, &count)| count)?;
        if most == 0 {
            return None;
        }
        let (mut support, mut features, mut pairs) = (0_u32, 0_u32, 0_u32);
        for (k, step) in RING.into_iter().enumerate() {
            let turned = if k < 8 { (k + turn) % 8 } else { k };
            let (Some(p), Some(q)) = (self.first.neighbour(i, step), self.second.neighbour(j, RING[turned])) else {
                continue;
            };
            support += u32::from(self.matches[p * self.columns + q]);
            features += self.features[p];
            pairs += 1;
        }
        let mean = f64::from(features) / f64::from(pairs.max(1));
        (f64::from(support) >= THRESHOLD * mean.sqrt()).then_some(j)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const SIZES: [(usize, usize); 2] = [(640, 480), (640, 480)];

    /// 1500 points mapped by `map`, every fourth to a random place instead.
    fn pairs(map: impl Fn([f32; 2]) -> [f32; 2]) -> (Vec<[f32; 2]>, Vec<[f32; 2]>) {
        let mut rng = Pcg64Mcg::seed_from_u64(11);
        let mut random = || [rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)];
        let a: Vec<[f32; 2]> = (0..1500).map(|_| random()).collect();
        let b = a.iter().enumerate().map(|(k, &p)| if k % 4 == 0 { random() } else { map(p) }).collect();
        (a, b)
    }

    /// Shares of true and of false matches that are kept.
    fn kept(map: impl Fn([f32; 2]) -> [f32; 2], options: GmsOptions) -> (f64, f64) {
        let (a, b) = pairs(&map);
        let kept = filter(&a, &b, SIZES, options);
        let inside = |k: &usize| {
            let [x, y] = map(a[*k]);
            (40.0..600.0).contains(&x) && (40.0..440.0).contains(&y)
        };
        let share =
            |chosen: Vec<usize>| chosen.iter().filter(|&&k| kept[k]).count() as f64 / chosen.len().max(1) as f64;
        let all = 0..a.len();
        (
            share(all.clone().filter(|k| k % 4 != 0).filter(inside).collect()),
            share(all.filter(|k| k % 4 == 0).collect()),
        )
    }

    #[test]
    fn a_shift_keeps_true_matches_and_drops_false_ones() {
        let (good, bad) = kept(|[x, y]| [x + 25.0, y - 14.0], GmsOptions { rotation: false, scale: false });
        assert!(good > 0.85 && bad < 0.1, "{good} of the true, {bad} of the false");
    }

    #[test]
    fn a_quarter_turn_needs_rotation() {
        // About the centre; the right angle keeps cells apart as far as the aspect ratio allows.
        let turn = |[x, y]: [f32; 2]| [320.0 - (y - 240.0), 240.0 + (x - 320.0)];
        let (without, _) = kept(turn, GmsOptions { rotation: false, scale: false });
        let (with, bad) = kept(turn, GmsOptions { rotation: true, scale: false });
        assert!(with > without + 0.2 && bad < 0.1, "{without} → {with}, {bad} false");
    }

    #[test]
    fn a_half_scale_needs_scale() {
        let shrink = |[x, y]: [f32; 2]| [160.0 + x / 2.0, 120.0 + y / 2.0];
        let (with, bad) = kept(shrink, GmsOptions { rotation: false, scale: true });
        assert!(with > 0.8 && bad < 0.15, "{with} true, {bad} false");
    }

    #[test]
    fn all_borders_are_treated_alike() {
        let grid = |shift| Grid { cells: 3, size: (30, 30), shift };
        let neighbours =
            |grid: &Grid, p| RING.into_iter().filter(|step| grid.neighbour(grid.cell(p), *step).is_some()).count();
        let corners = [[1.0, 1.0], [29.0, 1.0], [1.0, 29.0], [29.0, 29.0]];
        assert_eq!(corners.map(|p| neighbours(&grid([0.0; 2]), p)), [4; 4]);
        assert_eq!(corners.map(|p| neighbours(&grid([0.5; 2]), p)), [4; 4]);
        assert_eq!((grid([0.0; 2]).count(), grid([0.5, 0.0]).count()), (9, 12));
    }

    #[test]
    fn no_matches_are_no_error() {
        assert!(filter(&[], &[], SIZES, GmsOptions { rotation: true, scale: true }).is_empty());
    }
}
