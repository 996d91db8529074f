//! Parts of the map whose relative pose is unknown (Campos et al., "ORB-SLAM3", T-RO 2021, section VI).
//!
//! A camera that stays lost in view of something starts a new segment there. When the segment shows a place that another one knows,
//! the two are joined ([`crate::loop_closing::merge`]).

use slotmap::SecondaryMap;

use crate::map::KeyframeId;

/// Number of a segment.
type Segment = u32;

/// Which keyframe belongs to which segment, and in which one the camera is.
#[derive(Clone, Debug, Default)]
pub(crate) struct Segments {
    segment_of: SecondaryMap<KeyframeId, Segment>,
    current: Segment,
    /// Segments begun so far beside the first.
    begun: Segment,
}

impl Segments {
    /// Starts a segment, which becomes the current one.
    pub(crate) fn begin(&mut self) {
        self.begun += 1;
        self.current = self.begun;
    }

    /// Notes that a new keyframe belongs to the current segment.
    pub(crate) fn add(&mut self, keyframe: KeyframeId) {
        self.segment_of.insert(keyframe, self.current);
    }

    /// Whether `keyframe` belongs to the current segment.
    pub(crate) fn is_current(&self, keyframe: KeyframeId) -> bool {
        self.of(keyframe) == self.current
    }

    /// The camera was found near `keyframe`: its segment is the current one.
    pub(crate) fn enter(&mut self, keyframe: KeyframeId) {
        self.current = self.of(keyframe);
    }

    /// Whether the relative pose of two keyframes is known.
    pub(crate) fn are_joined(&self, a: KeyframeId, b: KeyframeId) -> bool {
        self.of(a) == self.of(b)
    }

    /// The keyframes of `order` in the segment of `keyframe`.
    pub(crate) fn with(&self, order: &[KeyframeId], keyframe: KeyframeId) -> Vec<KeyframeId> {
        order.iter().copied().filter(|&id| self.are_joined(id, keyframe)).collect()
    }

    /// Which of two keyframes belongs to the segment that moves when both are joined, and which to the one that stays: that which holds
    /// the `origin`, where the world is, or else that of the second.
    pub(crate) fn part_and_whole(
        &self,
        origin: Option<&KeyframeId>,
        (a, b): (KeyframeId, KeyframeId),
    ) -> (KeyframeId, KeyframeId) {
        if origin.is_some_and(|&origin| self.are_joined(origin, a)) { (b, a) } else { (a, b) }
    }

    /// The segment of `part` becomes a part of the segment of `whole`.
    pub(crate) fn join(&mut self, part: KeyframeId, whole: KeyframeId) {
        let (part, whole) = (self.of(part), self.of(whole));
        self.segment_of.values_mut().filter(|s| **s == part).for_each(|s| *s = whole);
        self.current = if self.current == part { whole } else { self.current };
    }

    /// The keyframes of the largest segment, of equal ones the oldest.
    pub(crate) fn largest(&self, order: &[KeyframeId]) -> Vec<KeyframeId> {
        let segments = (0..=self.begun).rev().map(|s| order.iter().copied().filter(|&id| self.of(id) == s).collect());
        segments.max_by_key(Vec::len).unwrap_or_default()
    }

    fn of(&self, keyframe: KeyframeId) -> Segment {
        self.segment_of.get(keyframe).copied().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slotmap::SlotMap;

    #[test]
    fn segments_begin_and_join() {
        let mut arena = SlotMap::<KeyframeId, ()>::with_key();
        let order: Vec<_> = (0..5).map(|_| arena.insert(())).collect();
        let mut segments = Segments::default();
        order[..3].iter().for_each(|&id| segments.add(id));
        segments.begin();
        order[3..].iter().for_each(|&id| segments.add(id));
        assert!(segments.are_joined(order[0], order[2]) && !segments.are_joined(order[0], order[3]));
        assert_eq!(segments.with(&order, order[4]), order[3..]);
        assert_eq!(segments.largest(&order), order[..3]);
        let moves = |a, b| segments.part_and_whole(order.first(), (order[a], order[b]));
        assert_eq!([moves(4, 1), moves(1, 4)], [(order[4], order[1]); 2], "the segment of the origin stays");
        segments.join(order[4], order[0]);
        assert_eq!(segments.largest(&order), order);
        segments.begin();
        assert!(!segments.is_current(order[0]));
        segments.enter(order[3]);
        assert!(segments.is_current(order[0]));
        let next = arena.insert(());
        segments.add(next);
        assert!(segments.are_joined(next, order[0]));
    }
}
