//! The pixels along the outlines of labels, and those without depth that adjoin them.

/// Pixels up to this far from another label belong to its rim, working pixels; a pixel beside it is at 1.
const WIDTH: usize = 3;
/// A gap in the depth belongs to the rim up to this far into it, working pixels: beside somebody a metre or two away the shadow of the
/// projector is as wide.
const REACH: u8 = 8;

/// Marks rims.
#[derive(Debug, Default)]
pub(crate) struct Rim {
    marks: Vec<bool>,
    /// Whether a pixel lies beside another label, …
    beside: Vec<bool>,
    /// … or near such a pixel of its row.
    spread: Vec<bool>,
    /// Steps through gaps from the rim to each pixel, [`FAR`] where there are too many.
    steps: Vec<u8>,
}

/// Too many steps.
const FAR: u8 = REACH + 1;

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
            (1..WIDTH).for_each(|distance| spread_by(beside, distance, spread));
        }
        self.marks.clone_from(&self.spread);
        (1..WIDTH).for_each(|rows| spread_by(&self.spread, rows * width, &mut self.marks));
    }

    /// Adds the pixels without `depth` that are joined with the rim by such pixels.
    pub(crate) fn add_gaps(&mut self, width: usize, depth: &[f32]) {
        let (marks, steps) = (&mut self.marks, &mut self.steps);
        steps.clear();
        steps.extend(marks.iter().map(|&mark| if mark { 0 } else { FAR }));
        let through = |steps: &[u8], i: usize, before: Option<usize>, above: Option<usize>| {
            let of = |j: Option<usize>| j.and_then(|j| steps.get(j)).copied().unwrap_or(FAR);
            steps[i].min(of(before).min(of(above)).saturating_add(1))
        };
        let open = |i: &usize| depth[*i] == 0.0;
        for i in (0..depth.len()).filter(open) {
            steps[i] = through(steps, i, (i % width > 0).then(|| i - 1), i.checked_sub(width));
        }
        for i in (0..depth.len()).rev().filter(open) {
            steps[i] = through(steps, i, ((i + 1) % width > 0).then_some(i + 1), Some(i + width));
            marks[i] |= steps[i] < FAR;
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
        // What is beside the pixel reaches two further, in its row and then in all columns.
        let expected = |i: usize| match (i / 12).abs_diff(4) {
            0..=2 => i % 12 >= 8,
            3 => i % 12 >= 9,
            _ => false,
        };
        let wrong: Vec<usize> = (0..144).filter(|&i| rim.marks()[i] != expected(i)).collect();
        assert!(wrong.is_empty(), "{wrong:?}");
    }

    #[test]
    fn gaps_belong_to_the_rim_up_to_a_limit_and_only_where_they_adjoin_it() {
        // Rows of 30: the mover is on the left; the second row has a gap from its rim on, the third one further away, and the first ends
        // in a gap.
        let labels: Vec<u16> = (0..90).map(|i| u16::from(i % 30 < 4)).collect();
        let gap = |i: usize| (i == 29) || (36..60).contains(&i) || i >= 68;
        let depth: Vec<f32> = (0..90).map(|i| if gap(i) { 0.0 } else { 1.0 }).collect();
        let mut rim = Rim::default();
        rim.find(30, &labels);
        rim.add_gaps(30, &depth);
        let ends: Vec<usize> =
            rim.marks().chunks_exact(30).map(|row| row.iter().rposition(|m| *m).map_or(0, |u| u + 1)).collect();
        let reach = usize::from(REACH);
        assert_eq!(ends, [7, 7 + reach, 7 + reach - 1]);
        assert!(rim.marks()[60 + 8] && !rim.marks()[60 + 7], "joined by way of the row above");
    }
}
