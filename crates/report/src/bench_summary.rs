//! The summary of a bench that stands in the README.

use std::fmt::Write;

use crate::bench::{BenchRun, Group, select, sequences};
use crate::published::{self, Metric};
use crate::table::number;
use crate::{ReportError, Summary};

/// Lines between which the summary stands.
pub const BEGIN: &str = "<!-- bench -->";
/// The end of the summary.
pub const END: &str = "<!-- /bench -->";

/// The sequence whose times are stated, where it is there.
const TIMED: &str = "composite-demo";
/// Variants that make the columns, with their names.
const COLUMNS: [(&str, &str); 3] = [("pfd", "`pfd`"), ("none", "`none`"), ("given", "true masks")];
/// Other systems on the same frames.
const OTHERS: [&str; 2] = ["ORB-SLAM3, movers painted out", "ORB-SLAM3"];

/// Sequences that the README describes in words.
pub const DESCRIPTIONS: [(&str, &str); 6] = [
    ("tum-fr1-xyz-first180", "freiburg1_xyz, first 180 frames (real, static)"),
    ("composite-demo", "composite-demo (real frames, rendered people; bundled)"),
    ("composite-walking", "composite-walking (the same, closer passes)"),
    ("synthetic-dev-walking-xyz", "synthetic office, walking, xyz"),
    ("synthetic-dev-walking-half", "synthetic office, walking, half sphere"),
    ("synthetic-dev-sitting-xyz", "synthetic office, sitting, xyz"),
];

/// The summary: errors of the modes beside ORB-SLAM3, then a paragraph of other figures. `about` says where the figures come from,
/// such as a commit.
pub fn summary(runs: &[BenchRun], about: &str) -> String {
    let header: Vec<&str> =
        COLUMNS.iter().map(|(_, name)| *name).chain(["ORB-SLAM3, true masks", "ORB-SLAM3"]).collect();
    let mut text = format!("| sequence | {} |\n|---|{}\n", header.join(" | "), "---|".repeat(header.len()));
    for sequence in sequences(runs) {
        text += &row(runs, sequence);
    }
    let seeds = match seeds(runs) {
        1 => "one seed".to_owned(),
        n => format!("median of {n} seeds"),
    };
    // Writing to a string cannot fail.
    let _ = writeln!(text, "\nBy `pfd-slam bench` at {about}; {seeds}. {}", facts(runs).join(" "));
    text
}

fn row(runs: &[BenchRun], sequence: &str) -> String {
    let described = DESCRIPTIONS.iter().find(|(name, _)| *name == sequence).map_or(sequence, |(_, text)| text);
    let ate = |variant: &str| {
        Group(&select(runs, sequence, variant)).median(|run| run.summary.ate.map(|statistics| statistics.rmse))
    };
    let published = published::of(sequence, Metric::Ate);
    let other = |system: &str| published.iter().find(|p| p.system == system).map(|p| p.value);
    let ours = COLUMNS.iter().map(|(variant, _)| number(ate(variant), 4));
    let cells: Vec<String> = ours.chain(OTHERS.iter().map(|system| number(other(system), 4))).collect();
    format!("| {described} | {} |\n", cells.join(" | "))
}

fn seeds(runs: &[BenchRun]) -> usize {
    let mut seeds: Vec<u64> = runs.iter().map(|run| run.summary.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    seeds.len()
}

/// Sentences on frames, times and masks of mode pfd, each where its figures are there.
fn facts(runs: &[BenchRun]) -> Vec<String> {
    let ours: Vec<&BenchRun> = runs.iter().filter(|run| run.variant == "pfd").collect();
    let mut facts = Vec::new();
    if let Some(least) = ours.iter().map(|run| 100.0 * run.summary.tracked).min_by(f64::total_cmp) {
        facts.push(match rounded_down(least) {
            share if share >= 100.0 => "Mode `pfd` tracks every frame of each run.".to_owned(),
            share => format!("Mode `pfd` tracks at least {share:.1} % of the frames of each run."),
        });
    }
    let timed: Vec<&BenchRun> = ours.iter().filter(|run| run.summary.sequence == TIMED).copied().collect();
    if !timed.is_empty() {
        let at = |time: fn(&Summary) -> f64| number(Group(&timed).median(|run| Some(time(&run.summary))), 1);
        facts.push(format!(
            "On {TIMED}, segmentation takes {} ms a frame in the median (p99 {} ms) and tracking {} ms (p99 {} ms).",
            at(|s| s.timing_ms.segmentation.median),
            at(|s| s.timing_ms.segmentation.p99),
            at(|s| s.timing_ms.tracking.median),
            at(|s| s.timing_ms.tracking.p99),
        ));
    }
    let recalls = ours.iter().filter_map(|run| Some(100.0 * run.masks.as_ref()?.recall?));
    let (least, most) = recalls.fold((f64::INFINITY, 0.0_f64), |(low, high), r| (low.min(r), high.max(r)));
    let wrong = ours.iter().filter_map(|run| Some(100.0 * run.masks.as_ref()?.static_masked.mean?)).fold(0.0, f64::max);
    if least.is_finite() {
        facts.push(format!(
            "Its masks find {least:.0} to {most:.0} % of the moving pixels, and take at most {:.1} % of the static ones with \
             them (means over a sequence).",
            rounded_up(wrong)
        ));
    }
    facts
}

/// Steps of what is stated to one decimal.
const PER_ONE: f64 = 10.0;
/// Far below a step, far above what binary fractions are off by: 99.9 stays 99.9.
const ROUNDING_ERROR: f64 = 1e-9;

/// The largest number with one decimal that `value` reaches.
fn rounded_down(value: f64) -> f64 {
    (value * PER_ONE + ROUNDING_ERROR).floor() / PER_ONE
}

/// The smallest number with one decimal that `value` does not exceed.
fn rounded_up(value: f64) -> f64 {
    (value * PER_ONE - ROUNDING_ERROR).ceil() / PER_ONE
}

/// `text` with `summary` between [`BEGIN`] and [`END`].
///
/// # Errors
/// [`ReportError::Markers`] when the text has no such lines.
pub fn insert(text: &str, summary: &str) -> Result<String, ReportError> {
    let (before, rest) = text.split_once(BEGIN).ok_or(ReportError::Markers { begin: BEGIN, end: END })?;
    let (_, after) = rest.split_once(END).ok_or(ReportError::Markers { begin: BEGIN, end: END })?;
    Ok(format!("{before}{BEGIN}\n{summary}{END}{after}"))
}

/// What stands between the lines.
pub fn inserted(text: &str) -> Option<&str> {
    Some(text.split_once(BEGIN)?.1.split_once(END)?.0.trim_start_matches('\n'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::tests::run;

    #[test]
    fn the_summary_has_a_row_per_sequence() {
        let mut runs = [
            run("composite-demo", "pfd", 0, 0.011),
            run("composite-demo", "pfd", 1, 0.012),
            run("composite-demo", "pfd", 2, 0.3),
            run("my-room", "none", 0, 0.02),
        ];
        runs[0].summary.tracked = 0.9998;
        let text = summary(&runs, "commit abc");
        assert!(text.contains(&format!("| {} | 0.0120 | – | – | 0.0123 | 0.0119 |\n", DESCRIPTIONS[1].1)), "{text}");
        assert!(text.contains("| my-room | – | 0.0200 | – | – | – |\n"), "{text}");
        assert!(text.contains("at commit abc; median of 3 seeds. Mode `pfd` tracks at least 99.9 %"), "{text}");
    }

    #[test]
    fn bounds_are_not_rounded_to_what_is_not_reached() {
        assert_eq!((rounded_down(99.97), rounded_down(100.0 * 0.999), rounded_down(100.0)), (99.9, 99.9, 100.0));
        assert_eq!((rounded_up(2.01), rounded_up(100.0 * 0.023), rounded_up(0.0)), (2.1, 2.3, 0.0));
    }

    #[test]
    fn only_what_stands_between_the_lines_is_replaced() {
        let text = format!("before\n{BEGIN}\nold\n{END}\nafter\n");
        let new = insert(&text, "new\n").unwrap();
        assert_eq!(new, format!("before\n{BEGIN}\nnew\n{END}\nafter\n"));
        assert_eq!(inserted(&new), Some("new\n"));
        assert!(insert("no such lines", "new").unwrap_err().to_string().contains(BEGIN));
    }
}
