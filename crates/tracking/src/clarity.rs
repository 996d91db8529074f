//! Whether a frame shows the map as clearly as those just before it.

use std::collections::VecDeque;

use pfd_geometry::Stamp;

/// How long a frame is compared with those before it, seconds: five frames at 30 Hz.
const WINDOW: f64 = 0.17;
/// A frame that finds less than this share of what the best of them found is blurred, or has something else wrong.
const CLEAR_SHARE: f64 = 0.75;

/// The share of the map points in view that the last frames found.
///
/// A keyframe is due when few points are left, and blur leaves few: without this the worst images would become keyframes, and a map that
/// consists of few keyframes cannot make up for what one of them places wrong. The share, and not the number, as a camera that turns away
/// from what is known finds fewer in a clear image as well, and must not wait.
#[derive(Clone, Debug, Default)]
pub(crate) struct Clarity {
    recent: VecDeque<(Stamp, f64)>,
}

impl Clarity {
    /// Records of how many points in view the frame found how many.
    pub(crate) fn observe(&mut self, stamp: Stamp, (found, in_view): (usize, usize)) {
        self.recent.push_back((stamp, found as f64 / in_view.max(1) as f64));
        while self.recent.front().is_some_and(|(then, _)| stamp.seconds_since(*then) > WINDOW) {
            self.recent.pop_front();
        }
    }

    /// Whether the last frame finds much less than the best of those before it.
    pub(crate) fn is_poor(&self) -> bool {
        let best = self.recent.iter().map(|(_, share)| *share).fold(0.0, f64::max);
        self.recent.back().is_some_and(|(_, last)| *last < CLEAR_SHARE * best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether frames at 30 Hz that find so many of so many points are poor.
    fn poor(frames: &[(usize, usize)]) -> Vec<bool> {
        let mut clarity = Clarity::default();
        let mut observe = |(i, frame): (usize, &(usize, usize))| {
            clarity.observe(Stamp::default().offset_by(i as f64 / 30.0), *frame);
            clarity.is_poor()
        };
        frames.iter().enumerate().map(&mut observe).collect()
    }

    #[test]
    fn a_blurred_frame_is_poor_and_the_clear_one_after_it_is_not() {
        assert_eq!(poor(&[(500, 1000), (480, 1000), (310, 1000), (450, 1000)]), [false, false, true, false]);
    }

    #[test]
    fn a_camera_that_turns_away_finds_fewer_of_fewer() {
        assert_eq!(poor(&[(500, 1000), (300, 600), (150, 300), (0, 0)]), [false, false, false, true]);
    }

    #[test]
    fn what_stays_poor_is_usual() {
        let mut frames = vec![(500, 1000); 3];
        frames.extend([(200, 1000); 7]);
        let found = poor(&frames);
        assert_eq!(found[..8], [false, false, false, true, true, true, true, true]);
        assert_eq!(found[8..], [false, false], "a sixth of a second later");
    }
}
