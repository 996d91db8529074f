//! Tables over many runs: sequences × variants (modes or parameter values), median over seeds.

use pfd_evaluation::statistics::quantile;
use pfd_evaluation::{MaskSummary, Statistics};
use serde::{Deserialize, Serialize};

use crate::Summary;
use crate::published::{self, Metric};
use crate::table::{Table, number, percent};

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
struct Group<'a>(&'a [&'a BenchRun]);

impl Group<'_> {
    /// Median over the seeds; `None` where no run has the figure.
    fn median(&self, figure: impl Fn(&BenchRun) -> Option<f64>) -> Option<f64> {
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

fn select<'a>(runs: &'a [BenchRun], sequence: &str, variant: &str) -> Vec<&'a BenchRun> {
    runs.iter().filter(|run| run.summary.sequence == sequence && run.variant == variant).collect()
}

fn ate(run: &BenchRun) -> Option<f64> {
    run.summary.ate.map(|s| s.rmse)
}

/// All tables that the runs give.
pub fn tables(runs: &[BenchRun]) -> Vec<Table> {
    let errors: [(&str, &str, Metric, usize, StatisticsOf); 3] = [
        ("Absolute trajectory error (ATE)", "m", Metric::Ate, 4, |s| s.ate),
        ("Relative pose error, translation", "m/s", Metric::RpeTranslation, 4, |s| s.rpe_translation),
        ("Relative pose error, rotation", "deg/s", Metric::RpeRotation, 3, |s| s.rpe_rotation_deg),
    ];
    let mut tables = Vec::new();
    for (title, unit, metric, decimals, of) in errors {
        let cell = |group: Group<'_>| {
            let rmse = group.median(|run| of(&run.summary).map(|s| s.rmse));
            let deviation = group.median(|run| of(&run.summary).map(|s| s.std));
            format!("{} ({})", number(rmse, decimals), number(deviation, decimals))
        };
        let note = "RMSE, in brackets the standard deviation. Median over the seeds.";
        tables.push(grid(runs, &format!("{title}, {unit}"), note, cell));
        tables.extend(compared(runs, title, unit, metric, decimals, of));
    }
    tables.push(grid(runs, "Frames with a pose", "Share of the frames.", |group| {
        percent(group.median(|run| Some(run.summary.tracked)))
    }));
    tables.push(times(runs));
    tables.extend(masks(runs));
    tables
}

type StatisticsOf = fn(&Summary) -> Option<Statistics>;

/// A table with a row per sequence and a column per variant.
fn grid(runs: &[BenchRun], title: &str, note: &str, cell: impl Fn(Group<'_>) -> String) -> Table {
    let variants = variants(runs);
    let row = |sequence: &str| {
        let cells = variants.iter().map(|variant| match select(runs, sequence, variant).as_slice() {
            [] => "–".to_owned(),
            group => cell(Group(group)),
        });
        std::iter::once(sequence.to_owned()).chain(cells).collect()
    };
    Table {
        title: title.to_owned(),
        note: note.to_owned(),
        header: std::iter::once("sequence").chain(variants.iter().copied()).map(str::to_owned).collect(),
        rows: sequences(runs).into_iter().map(row).collect(),
    }
}

/// Ours beside published figures, for sequences known by name.
fn compared(
    runs: &[BenchRun],
    title: &str,
    unit: &str,
    metric: Metric,
    decimals: usize,
    of: StatisticsOf,
) -> Option<Table> {
    let mut rows = Vec::new();
    for sequence in sequences(runs) {
        let published = published::of(sequence, metric);
        if published.is_empty() {
            continue;
        }
        for variant in variants(runs) {
            let value = Group(&select(runs, sequence, variant)).median(|run| of(&run.summary).map(|s| s.rmse));
            rows.push(vec![
                sequence.to_owned(),
                format!("ours, {variant}"),
                number(value, decimals),
                "this run".into(),
            ]);
        }
        rows.extend(published.iter().map(|p| {
            vec![sequence.to_owned(), p.system.to_owned(), number(Some(p.value), decimals), p.source.to_owned()]
        }));
    }
    let header = ["sequence", "system", &format!("RMSE, {unit}"), "source"].map(str::to_owned).to_vec();
    let note = "Other systems' figures are quoted, on other hardware, not run again.".to_owned();
    (!rows.is_empty()).then(|| Table { title: format!("{title} beside others"), note, header, rows })
}

fn times(runs: &[BenchRun]) -> Table {
    let cell = |group: Group<'_>| {
        let at = |time: fn(&Summary) -> f64| number(group.median(|run| Some(time(&run.summary))), 1);
        format!(
            "{} + {} = {} (p99 {})",
            at(|s| s.timing_ms.segmentation.median),
            at(|s| s.timing_ms.tracking.median),
            at(|s| s.timing_ms.total.median),
            at(|s| s.timing_ms.total.p99)
        )
    };
    let note =
        "Segmentation + tracking = total, medians over the frames. The paper: 82.2 + 25.5 ms on an i5-8250U (Table 8).";
    grid(runs, "Time per frame, ms", note, cell)
}

/// Quality of the masks; `None` when no sequence has true ones.
fn masks(runs: &[BenchRun]) -> Option<Table> {
    let mut rows = Vec::new();
    for sequence in sequences(runs) {
        for variant in variants(runs) {
            let runs = select(runs, sequence, variant);
            let group = Group(&runs);
            let share =
                |of: fn(&MaskSummary) -> Option<f64>| percent(group.median(|run| run.masks.as_ref().and_then(of)));
            if group.0.iter().any(|run| run.masks.is_some()) {
                let shares = [
                    share(|m| m.precision),
                    share(|m| m.recall),
                    share(|m| m.iou),
                    share(|m| m.static_masked.mean),
                    share(|m| m.static_masked.max),
                ];
                rows.push([vec![sequence.to_owned(), variant.to_owned()], shares.to_vec()].concat());
            }
        }
    }
    let header = ["sequence", "variant", "precision", "recall", "IoU", "static pixels masked", "worst frame"];
    let note = "Means over the frames in which something moves; static pixels over all frames.".to_owned();
    (!rows.is_empty()).then(|| Table {
        title: "Masks".to_owned(),
        note,
        header: header.map(str::to_owned).to_vec(),
        rows,
    })
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
mod tests {
    use super::*;
    use crate::Timing;

    fn run(sequence: &str, variant: &str, seed: u64, rmse: f64) -> BenchRun {
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
            keyframes: 0,
            map_points: 0,
            mode: variant.into(),
            seed,
            config: serde_json::Value::Null,
        };
        BenchRun { variant: variant.into(), summary, masks: None }
    }

    #[test]
    fn cells_are_medians_over_seeds() {
        let runs =
            [run("a", "pfd", 0, 0.3), run("a", "pfd", 1, 0.1), run("a", "pfd", 2, 0.2), run("b", "none", 0, 1.0)];
        let table = &tables(&runs)[0];
        assert_eq!(table.header, ["sequence", "pfd", "none"]);
        assert_eq!(table.rows[0][1..], ["0.2000 (0.0000)", "–"]);
        assert_eq!(table.rows[1][1..], ["–", "1.0000 (0.0000)"]);
        assert_eq!(median_run(&runs, "a", "pfd").unwrap().summary.seed, 2);
        assert!(median_run(&runs, "b", "pfd").is_none());
    }

    #[test]
    fn known_sequences_stand_beside_published_figures() {
        let runs = [run("rgbd_dataset_freiburg3_walking_xyz", "pfd", 0, 0.012)];
        let table = tables(&runs).into_iter().find(|t| t.title.contains("(ATE) beside others")).unwrap();
        assert_eq!(table.rows[0][1..3], ["ours, pfd", "0.0120"]);
        assert!(table.rows.iter().any(|row| row[1] == "ORB-SLAM2" && row[2] == "0.6140"));
    }
}
