//! Many runs: sequences × variants (modes or parameter values) × seeds.

use pfd_evaluation::MaskSummary;
use pfd_evaluation::statistics::quantile;
use serde::{Deserialize, Serialize};

use crate::Summary;

/// One run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BenchRun {
    /// Name of the variant: a mode, or a parameter with its value.
    pub variant: String,
    /// The figures of `report.json`.
    pub summary: Summary,
    /// Quality of the masks, where the true ones are known.
    pub masks: Option<MaskSummary>,
}

/// All runs of one variant on one sequence; they differ in the seed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Group<'a>(pub(crate) &'a [&'a BenchRun]);

impl Group<'_> {
    /// Median over the seeds; `None` where no run has the figure.
    pub(crate) fn median(&self, figure: impl Fn(&BenchRun) -> Option<f64>) -> Option<f64> {
        quantile(&self.0.iter().filter_map(|run| figure(run)).collect::<Vec<_>>(), 0.5)
    }
}

/// Distinct values in the order of their first appearance.
fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut seen = Vec::new();
    for value in values {
        if !seen.contains(&value) {
            seen.push(value);
        }
    }
    seen
}

/// Names of the sequences, in order.
pub fn sequences(runs: &[BenchRun]) -> Vec<&str> {
    distinct(runs.iter().map(|run| run.summary.sequence.as_str()))
}

/// Names of the variants, in order.
pub fn variants(runs: &[BenchRun]) -> Vec<&str> {
    distinct(runs.iter().map(|run| run.variant.as_str()))
}

/// The run with the median absolute error (the lower one of two) of a variant on a sequence.
pub fn median_run<'a>(runs: &'a [BenchRun], sequence: &str, variant: &str) -> Option<&'a BenchRun> {
    let mut all = select(runs, sequence, variant);
    all.sort_by(|a, b| ate(a).unwrap_or(f64::INFINITY).total_cmp(&ate(b).unwrap_or(f64::INFINITY)));
    all.get(all.len().saturating_sub(1) / 2).copied()
}

/// The runs of a variant on a sequence.
pub(crate) fn select<'a>(runs: &'a [BenchRun], sequence: &str, variant: &str) -> Vec<&'a BenchRun> {
    runs.iter().filter(|run| run.summary.sequence == sequence && run.variant == variant).collect()
}

fn ate(run: &BenchRun) -> Option<f64> {
    run.summary.ate.map(|s| s.rmse)
}

/// One line of `bench.csv`: every figure of one run.
#[derive(Clone, Debug, Serialize)]
pub struct CsvRow<'a> {
    sequence: &'a str,
    variant: &'a str,
    seed: u64,
    frames: usize,
    tracked: f64,
    ate_rmse_m: Option<f64>,
    ate_std_m: Option<f64>,
    rpe_translation_rmse_m_per_s: Option<f64>,
    rpe_rotation_rmse_deg_per_s: Option<f64>,
    segmentation_median_ms: f64,
    segmentation_p99_ms: f64,
    tracking_median_ms: f64,
    tracking_p99_ms: f64,
    total_p99_ms: f64,
    mask_precision: Option<f64>,
    mask_recall: Option<f64>,
    mask_iou: Option<f64>,
    static_masked_mean: Option<f64>,
    static_masked_max: Option<f64>,
}

impl<'a> From<&'a BenchRun> for CsvRow<'a> {
    fn from(run: &'a BenchRun) -> Self {
        let (s, m) = (&run.summary, run.masks.as_ref());
        Self {
            sequence: &s.sequence,
            variant: &run.variant,
            seed: s.seed,
            frames: s.frames,
            tracked: s.tracked,
            ate_rmse_m: s.ate.map(|e| e.rmse),
            ate_std_m: s.ate.map(|e| e.std),
            rpe_translation_rmse_m_per_s: s.rpe_translation.map(|e| e.rmse),
            rpe_rotation_rmse_deg_per_s: s.rpe_rotation_deg.map(|e| e.rmse),
            segmentation_median_ms: s.timing_ms.segmentation.median,
            segmentation_p99_ms: s.timing_ms.segmentation.p99,
            tracking_median_ms: s.timing_ms.tracking.median,
            tracking_p99_ms: s.timing_ms.tracking.p99,
            total_p99_ms: s.timing_ms.total.p99,
            mask_precision: m.and_then(|m| m.precision),
            mask_recall: m.and_then(|m| m.recall),
            mask_iou: m.and_then(|m| m.iou),
            static_masked_mean: m.and_then(|m| m.static_masked.mean),
            static_masked_max: m.and_then(|m| m.static_masked.max),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::Timing;
    use pfd_evaluation::Statistics;

    pub(crate) fn run(sequence: &str, variant: &str, seed: u64, rmse: f64) -> BenchRun {
        let summary = Summary {
            sequence: sequence.into(),
            frames: 10,
            tracked: 1.0,
            skipped: 0,
            unpaired: 0,
            ate: Statistics::of([rmse]),
            ate_live: None,
            rpe_translation: None,
            rpe_rotation_deg: None,
            timing_ms: Timing::default(),
            stages_ms: Vec::new(),
            keyframes: None,
            map_points: None,
            mode: variant.into(),
            seed,
            config: serde_json::Value::Null,
        };
        BenchRun { variant: variant.into(), summary, masks: None }
    }

    #[test]
    fn the_median_run_is_one_of_the_runs() {
        let runs =
            [run("a", "pfd", 0, 0.3), run("a", "pfd", 1, 0.1), run("a", "pfd", 2, 0.2), run("b", "none", 0, 1.0)];
        assert_eq!(median_run(&runs, "a", "pfd").unwrap().summary.seed, 2);
        assert!(median_run(&runs, "b", "pfd").is_none());
        assert_eq!((sequences(&runs), variants(&runs)), (vec!["a", "b"], vec!["pfd", "none"]));
    }
}
