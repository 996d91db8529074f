//! The pixels along the outlines of labels, and those without depth that adjoin them.

use super::regions::neighbours;

/// Pixels up to this far from another label belong to its rim, working pixels; a pixel beside it is at 1.
pub(crate) const RIM_WIDTH: usize = 4;
/// A gap in the depth belongs to the rim up to this far into it, working pixels: beside somebody a metre or two away the shadow of the
/// projector is as wide.
const REACH: usize = 8;

/// Marks rims.
#[derive(Debug, Default)]
pub(crate) struct Rim {
    marks: Vec<bool>,
    /// Whether a pixel lies beside another label, …
    beside: Vec<bool>,
    /// … or near such a pixel of its row.
    spread: Vec<bool>,
    /// Pixels that were reached last on the way into gaps, …
    reached: Vec<u32>,
    /// … and those that are reached from there.
    next: Vec<u32>,
}

impl Rim {
    /// Whether each pixel lies on the rim of a label; as found last.
    pub(crate) fn marks(&self) -> &[bool] {
        &self.marks
    }

    /// Marks the pixels around each change of label in an image of `width` columns.
    pub(crate) fn find(&mut self, width: usize, labels: &[u16]) {
        let beside = &mut self.beside;
        beside.clear();
        beside.resize(labels.len(), false);
        for (beside, labels) in beside.chunks_exact_mut(width).zip(labels.chunks_exact(width)) {
            mark_steps(labels, 1, beside);
        }
        mark_steps(labels, width, beside);
        self.spread.clone_from(beside);
        for (spread, beside) in self.spread.chunks_exact_mut(width).zip(beside.chunks_exact(width)) {
            (1..RIM_WIDTH).for_each(|distance| spread_by(beside, distance, spread));
        }
        self.marks.clone_from(&self.spread);
        (1..RIM_WIDTH).for_each(|rows| spread_by(&self.spread, rows * width, &mut self.marks));
    }

    /// Adds the pixels without `depth` that are joined with the rim by at most [`REACH`] such pixels, in an image of this size.
    pub(crate) fn add_gaps(&mut self, size: (usize, usize), depth: &[f32]) {
        let (marks, reached) = (&mut self.marks, &mut self.reached);
        reached.clear();
        reached.extend((0..marks.len() as u32).filter(|&i| marks[i as usize]));
        for _ in 0..REACH {
            self.next.clear();
            for j in reached.iter().flat_map(|&i| neighbours(size, i as usize)).flatten() {
                if depth[j] == 0.0 && !marks[j] {
                    marks[j] = true;
                    self.next.push(j as u32);
                }
            }
            std::mem::swap(reached, &mut self.next);
        }
    }
}

/// Marks both of each two pixels `step` apart that have different labels.
fn mark_steps(labels: &[u16], step: usize, marks: &mut [bool]) {
    let differs = || labels.iter().zip(labels.iter().skip(step)).map(|(a, b)| a != b);
    marks.iter_mut().zip(differs()).for_each(|(mark, differs)| *mark |= differs);
    marks.iter_mut().skip(step).zip(differs()).for_each(|(mark, differs)| *mark |= differs);
}

/// Marks what lies `distance` pixels after or before a mark.
fn spread_by(marks: &[bool], distance: usize, out: &mut [bool]) {
    out.iter_mut().skip(distance).zip(marks).for_each(|(o, m)| *o |= m);
    out.iter_mut().zip(marks.iter().skip(distance)).for_each(|(o, m)| *o |= m);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rims_reach_across_rows_and_not_around_the_ends_of_rows() {
        // One pixel at the end of the fifth of twelve rows.
        let mut labels = [0; 144];
        labels[5 * 12 - 1] = 1;
        let mut rim = Rim::default();
        rim.find(12, &labels);
        // What is beside the pixel reaches further by the same number of columns and then of rows.
        let expected = |i: usize| match (i / 12).abs_diff(4) {
            away if away < RIM_WIDTH => i % 12 >= 11 - RIM_WIDTH,
            RIM_WIDTH => i % 12 >= 12 - RIM_WIDTH,
            _ => false,
        };
        let wrong: Vec<usize> = (0..144).filter(|&i| rim.marks()[i] != expected(i)).collect();
        assert!(wrong.is_empty(), "{wrong:?}");
    }

    #[test]
    fn gaps_belong_to_the_rim_up_to_a_limit_and_only_where_they_adjoin_it() {
        // Rows of 40, the mover on the left, so that its rim begins in the first column. The second row is a gap from the rim on, the third
        // one from further away on; the first ends in a gap, which does not go on in the next row.
        let (rim_end, reach) = (3 + RIM_WIDTH, REACH);
        let gap = |i: usize| i == 39 || (40 + rim_end..80).contains(&i) || i > 80 + rim_end;
        let found = |columns: &dyn Fn(usize) -> usize| {
            let at = |i: usize| i / 40 * 40 + columns(i % 40);
            let depth: Vec<f32> = (0..120).map(|i| if gap(at(i)) { 0.0 } else { 1.0 }).collect();
            let labels: Vec<u16> = (0..120).map(|i| u16::from(at(i) % 40 < 3)).collect();
            let mut rim = Rim::default();
            rim.find(40, &labels);
            rim.add_gaps((40, 3), &depth);
            (0..120).map(|i| rim.marks()[at(i)]).collect::<Vec<_>>()
        };
        let expected = |i: usize| match (i / 40, i % 40) {
            (_, u) if u < rim_end => true,
            (1, u) => u < rim_end + reach,
            // Joined by way of the row above.
            (2, u) => u > rim_end && u < rim_end + reach - 1,
            _ => false,
        };
        for found in [found(&|u| u), found(&|u| 39 - u)] {
            let wrong: Vec<usize> = (0..120).filter(|&i| found[i] != expected(i)).collect();
            assert!(wrong.is_empty(), "{wrong:?}");
        }
    }
}
