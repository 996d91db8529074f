//! The pixels along the outlines of labels.

/// Pixels up to this far from another label belong to its rim, working pixels; a pixel beside it is at 1.
const WIDTH: usize = 3;

/// Marks rims.
#[derive(Debug, Default)]
pub(crate) struct Rim {
    marks: Vec<bool>,
    /// Whether a pixel lies beside another label, …
    beside: Vec<bool>,
    /// … or near such a pixel of its row.
    spread: Vec<bool>,
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
            (1..WIDTH).for_each(|distance| spread_by(beside, distance, spread));
        }
        self.marks.clone_from(&self.spread);
        (1..WIDTH).for_each(|rows| spread_by(&self.spread, rows * width, &mut self.marks));
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
}
