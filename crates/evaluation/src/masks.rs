//! Quality of motion masks.

use pfd_geometry::{GrayImage, Mask};
use serde::{Deserialize, Serialize};

use crate::EvaluationError;

/// Ground-truth value of a pixel that moves.
pub const MOVING: u8 = 255;
/// Ground-truth value of a pixel that does not move.
pub const STATIC: u8 = 0;
/// Ground-truth value of a pixel that counts neither way, such as a person who stands still.
pub const IGNORED: u8 = 128;

/// Pixel counts of one frame, ignored pixels left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MaskScore {
    /// Moving and masked.
    pub true_positive: u64,
    /// Static but masked.
    pub false_positive: u64,
    /// Moving but not masked.
    pub false_negative: u64,
    /// Static and not masked.
    pub true_negative: u64,
}

impl MaskScore {
    /// Compares a mask with the ground truth.
    ///
    /// # Errors
    /// [`EvaluationError::MaskSize`] when the sizes differ, [`EvaluationError::TruthValue`] for a value of the ground truth that
    /// is none of [`MOVING`], [`IGNORED`] and [`STATIC`].
    pub fn of(mask: &Mask, ground_truth: &GrayImage) -> Result<Self, EvaluationError> {
        if mask.image().size() != ground_truth.size() {
            return Err(EvaluationError::MaskSize { mask: mask.image().size(), ground_truth: ground_truth.size() });
        }
        let mut score = Self::default();
        for (i, (&masked, &truth)) in mask.image().pixels().iter().zip(ground_truth.pixels()).enumerate() {
            match (truth, masked != Mask::STATIC) {
                (IGNORED, _) => {}
                (MOVING, true) => score.true_positive += 1,
                (MOVING, false) => score.false_negative += 1,
                (STATIC, true) => score.false_positive += 1,
                (STATIC, false) => score.true_negative += 1,
                (value, _) => {
                    let (column, row) = (i % ground_truth.width(), i / ground_truth.width());
                    return Err(EvaluationError::TruthValue { value, column, row });
                }
            }
        }
        Ok(score)
    }

    /// Whether anything moves in the ground truth.
    pub fn has_movers(&self) -> bool {
        self.true_positive + self.false_negative > 0
    }

    /// Share of the masked pixels that move; `None` when nothing is masked.
    pub fn precision(&self) -> Option<f64> {
        ratio(self.true_positive, self.true_positive + self.false_positive)
    }

    /// Share of the moving pixels that are masked; `None` when nothing moves.
    pub fn recall(&self) -> Option<f64> {
        ratio(self.true_positive, self.true_positive + self.false_negative)
    }

    /// Intersection over union; `None` when nothing moves and nothing is masked.
    pub fn iou(&self) -> Option<f64> {
        ratio(self.true_positive, self.true_positive + self.false_positive + self.false_negative)
    }

    /// Share of the static pixels that are masked; `None` when nothing is static.
    pub fn static_masked(&self) -> Option<f64> {
        ratio(self.false_positive, self.false_positive + self.true_negative)
    }
}

impl std::ops::Add for MaskScore {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            true_positive: self.true_positive + other.true_positive,
            false_positive: self.false_positive + other.false_positive,
            false_negative: self.false_negative + other.false_negative,
            true_negative: self.true_negative + other.true_negative,
        }
    }
}

/// Quality over a sequence. Shares, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MaskSummary {
    /// Frames compared.
    pub frames: usize,
    /// Frames in which something moves.
    pub frames_with_movers: usize,
    /// Mean over the frames in which something moves and something is masked.
    pub precision: Option<f64>,
    /// Mean over the frames in which something moves.
    pub recall: Option<f64>,
    /// Mean over the frames in which something moves.
    pub iou: Option<f64>,
    /// Over the pixels of all frames together.
    pub pixels: PixelShares,
    /// Static pixels wrongly masked.
    pub static_masked: StaticMasked,
}

/// Shares over the pixels of all frames together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PixelShares {
    /// See [`MaskScore::precision`].
    pub precision: Option<f64>,
    /// See [`MaskScore::recall`].
    pub recall: Option<f64>,
    /// See [`MaskScore::iou`].
    pub iou: Option<f64>,
}

/// Share of the static pixels of a frame that are masked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StaticMasked {
    /// Mean over all frames.
    pub mean: Option<f64>,
    /// In the worst frame.
    pub max: Option<f64>,
}

impl MaskSummary {
    /// Summarises the frames of a sequence.
    pub fn of(scores: &[MaskScore]) -> Self {
        let moving: Vec<&MaskScore> = scores.iter().filter(|s| s.has_movers()).collect();
        let total = scores.iter().fold(MaskScore::default(), |a, b| a + *b);
        let wrong: Vec<f64> = scores.iter().filter_map(MaskScore::static_masked).collect();
        Self {
            frames: scores.len(),
            frames_with_movers: moving.len(),
            precision: mean(moving.iter().filter_map(|s| s.precision())),
            recall: mean(moving.iter().filter_map(|s| s.recall())),
            iou: mean(moving.iter().filter_map(|s| s.iou())),
            pixels: PixelShares { precision: total.precision(), recall: total.recall(), iou: total.iou() },
            static_masked: StaticMasked {
                mean: mean(wrong.iter().copied()),
                max: wrong.iter().copied().max_by(f64::total_cmp),
            },
        }
    }
}

fn ratio(part: u64, whole: u64) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    fn score(mask: &[u8], truth: &[u8]) -> MaskScore {
        let image = |values: &[u8]| Image::from_vec(values.len(), 1, values.to_vec()).unwrap();
        MaskScore::of(&Mask::from_image(image(mask)), &image(truth)).unwrap()
    }

    #[test]
    fn counts_by_hand() {
        let s = score(&[255, 255, 0, 0, 255, 0], &[255, 0, 255, 0, 128, 128]);
        assert_eq!(s, MaskScore { true_positive: 1, false_positive: 1, false_negative: 1, true_negative: 1 });
        assert_eq!((s.precision(), s.recall(), s.iou()), (Some(0.5), Some(0.5), Some(1.0 / 3.0)));
    }

    #[test]
    fn frames_without_movers_count_for_static_pixels_only() {
        let summary = MaskSummary::of(&[score(&[255, 0], &[255, 0]), score(&[255, 0], &[0, 0])]);
        assert_eq!((summary.frames, summary.frames_with_movers), (2, 1));
        assert_eq!((summary.precision, summary.iou), (Some(1.0), Some(1.0)));
        assert_eq!(summary.static_masked, StaticMasked { mean: Some(0.25), max: Some(0.5) });
        assert_eq!(summary.pixels.precision, Some(0.5));
        assert_eq!(MaskSummary::of(&[]).recall, None);
    }

    #[test]
    fn a_value_without_meaning_is_named() {
        let truth = Image::from_vec(2, 2, vec![0, 255, 128, 1]).unwrap();
        let error = MaskScore::of(&Mask::empty(2, 2), &truth).unwrap_err();
        assert!(matches!(error, EvaluationError::TruthValue { value: 1, column: 1, row: 1 }), "{error}");
    }

    #[test]
    fn sizes_must_agree() {
        let truth = Image::filled(3, 1, 0_u8);
        assert!(matches!(MaskScore::of(&Mask::empty(1, 3), &truth), Err(EvaluationError::MaskSize { .. })));
    }
}
