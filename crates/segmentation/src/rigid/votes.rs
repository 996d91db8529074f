//! Corners vote on whether the thing that they lie on moves.

use super::corners::CELL;

/// How many corners on a surface follow the camera motion, and how many move on their own.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Votes {
    still: u32,
    moving: u32,
}

/// Squared normalised residual from which a corner votes for motion (3 degrees of freedom, 99.8 %).
const VOTE_CHI2: f32 = 15.0;
/// Votes for motion that a thing needs at least: fewer may be one slipped edge.
const MIN_VOTES: u32 = 6;
/// Share of the cells of a thing (each holds at most one corner) that must vote for motion: a few corners do not speak for a large
/// surface.
const MIN_VOTED: f32 = 0.25;
impl Votes {
    /// Counts a corner by its squared normalised residual under the camera motion.
    pub(crate) fn add(&mut self, chi2: f32) {
        if chi2 > VOTE_CHI2 {
            self.moving += 1;
        } else {
            self.still += 1;
        }
    }

    /// Two of three corners and a good part of the surface's `pixels`.
    pub(crate) fn agree_on_motion(self, pixels: u32) -> bool {
        let covered = (self.moving as usize * CELL * CELL) as f32;
        self.moving >= MIN_VOTES.max(2 * self.still) && covered > MIN_VOTED * pixels as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn votes(still: u32, moving: u32) -> Votes {
        let mut votes = Votes::default();
        (0..still).for_each(|_| votes.add(1.0));
        (0..moving).for_each(|_| votes.add(100.0));
        votes
    }

    #[test]
    fn a_thing_moves_when_most_of_many_corners_say_so() {
        let pixels = (20 * CELL * CELL) as u32;
        assert!(votes(3, 12).agree_on_motion(pixels));
        assert!(!votes(7, 12).agree_on_motion(pixels), "not two of three");
        assert!(!votes(0, 4).agree_on_motion(pixels), "too few");
        assert!(!votes(0, 6).agree_on_motion(10 * pixels), "too few for so large a surface");
    }
}
