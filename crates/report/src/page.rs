//! `report.html` of one run.

use std::path::Path;

use pfd_evaluation::Statistics;
use pfd_geometry::StampedPose;

use crate::summary::{Errors, NO_ERRORS, Percentiles};
use crate::{FrameRow, ReportError, Sample, Summary, figures, html};

/// What the page of a run shows.
#[derive(Clone, Copy, Debug)]
pub struct RunPage<'a> {
    /// The figures.
    pub summary: &'a Summary,
    /// Errors against ground truth, in detail.
    pub errors: &'a Errors,
    /// Estimated poses.
    pub trajectory: &'a [StampedPose],
    /// One row a frame.
    pub frames: &'a [FrameRow],
    /// Sample frames with masks.
    pub samples: &'a [Sample],
}

impl RunPage<'_> {
    /// Writes the page.
    ///
    /// # Errors
    /// When a plot cannot be drawn or the file not be written.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        crate::error::write(path, self.html()?)
    }

    /// Writes one picture: the sample frame in which most is masked, beside the trajectory. Without samples there is none, and
    /// one of an earlier report is removed.
    ///
    /// # Errors
    /// When the plot cannot be drawn, or the file not be written or removed.
    pub fn write_picture(&self, path: &Path) -> Result<(), ReportError> {
        let Some(sample) = self.samples.iter().max_by(|a, b| a.masked.total_cmp(&b.masked)) else {
            return crate::error::remove(path);
        };
        crate::error::write(path, crate::picture::svg(self.summary, self.errors, self.trajectory, sample)?)
    }

    /// The text of the page.
    ///
    /// # Errors
    /// When a plot cannot be drawn.
    pub fn html(&self) -> Result<String, ReportError> {
        let ate = self.errors.ate.as_ref();
        let mut body = self.key_figures();
        body += &html::section("Trajectory", &html::plots(&figures::trajectory(ate, self.trajectory)?));
        if let Some(ate) = ate {
            let plots = figures::errors(ate, self.errors.rpe.as_ref())?;
            body += &html::section("Error over time", &html::plots(&plots));
        }
        if !self.samples.is_empty() {
            body += &html::section("What is taken to move", &html::samples(self.samples));
        }
        body += &html::section("Support", &html::plots(&figures::support(self.frames)?));
        body += &html::section("Time", &(html::plots(&figures::timing(self.frames)?) + &self.stages()));
        body += &self.configuration();
        Ok(html::page(&format!("PFD-SLAM: {}", self.summary.sequence), &body))
    }

    fn key_figures(&self) -> String {
        let s = self.summary;
        let statistics = |name: &str, unit: &str, s: Option<Statistics>| {
            let numbers = s.map_or(vec!["–".to_owned(); 6], |s| {
                [s.rmse, s.mean, s.median, s.std, s.min, s.max].map(|x| format!("{x:.4}")).to_vec()
            });
            [vec![format!("{name} ({unit})")], numbers].concat()
        };
        let mut rows = vec![
            statistics("ATE", "m", s.ate),
            statistics("RPE translation", "m/s", s.rpe_translation),
            statistics("RPE rotation", "deg/s", s.rpe_rotation_deg),
        ];
        if s.ate_live.is_some() {
            rows.insert(1, statistics("ATE of the poses as published", "m", s.ate_live));
        }
        let header = ["", "rmse", "mean", "median", "std", "min", "max"].map(str::to_owned);
        let facts = format!(
            "<p>{} frames, {:.1} % tracked; mode {}, seed {}{}; {} keyframes, {} map points; \
             {} frames unusable, {} images without depth.</p>\n",
            s.frames,
            100.0 * s.tracked,
            html::escape(&s.mode),
            s.seed,
            s.settings_note(),
            count(s.keyframes),
            count(s.map_points),
            s.skipped,
            s.unpaired
        );
        let note = if s.ate.is_some() { String::new() } else { format!("<p>{NO_ERRORS}.</p>\n") };
        facts + &note + &html::table(&header, &rows)
    }

    fn stages(&self) -> String {
        let t = &self.summary.timing_ms;
        let row = |name: &str, p: &Percentiles| {
            [vec![name.to_owned()], [p.median, p.mean, p.p99, p.max].map(|x| format!("{x:.2}")).to_vec()].concat()
        };
        let mut rows = vec![row("segmentation", &t.segmentation), row("tracking", &t.tracking), row("total", &t.total)];
        rows.extend(self.summary.stages_ms.iter().map(|stage| row(&stage.stage, &stage.percentiles)));
        let header = ["ms", "median", "mean", "p99", "max"].map(str::to_owned);
        html::table(&header, &rows)
    }

    fn configuration(&self) -> String {
        let json = serde_json::to_string_pretty(&self.summary.config).unwrap_or_default();
        format!(
            "<details><summary>Configuration{}</summary><pre>{}</pre></details>\n",
            self.summary.settings_note(),
            html::escape(&json)
        )
    }
}

fn count(number: Option<usize>) -> String {
    number.map_or_else(|| "unknown".to_owned(), |n| n.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Timing;

    fn summary() -> Summary {
        Summary {
            sequence: "a <room>".into(),
            frames: 2,
            tracked: 0.5,
            skipped: 0,
            unpaired: 0,
            ate: None,
            ate_live: None,
            rpe_translation: None,
            rpe_rotation_deg: None,
            timing_ms: Timing::default(),
            stages_ms: Vec::new(),
            keyframes: Some(1),
            map_points: Some(10),
            mode: "pfd".into(),
            seed: 1,
            config: serde_json::json!({"a": 1}),
        }
    }

    #[test]
    fn the_page_needs_no_other_file_and_no_ground_truth() {
        let (summary, errors) = (summary(), Errors::default());
        let page = RunPage { summary: &summary, errors: &errors, trajectory: &[], frames: &[], samples: &[] };
        let html = page.html().unwrap();
        assert!(html.contains("a &lt;room&gt;") && html.contains(NO_ERRORS) && html.contains("50.0 %"));
        assert!(!html.contains("as given to"));
        for outside in ["src=\"http", "href=\"http", "@import", "<script"] {
            assert!(!html.contains(outside), "{outside}");
        }
    }

    #[test]
    fn without_samples_no_picture_stays() {
        let (summary, errors) = (summary(), Errors::default());
        let page = RunPage { summary: &summary, errors: &errors, trajectory: &[], frames: &[], samples: &[] };
        let folder = tempfile::tempdir().unwrap();
        let picture = folder.path().join("picture.svg");
        std::fs::write(&picture, "old").unwrap();
        for _ in 0..2 {
            page.write_picture(&picture).unwrap();
            assert!(!picture.exists());
        }
    }

    #[test]
    fn settings_that_are_not_known_from_the_run_are_marked() {
        let (summary, errors) = (Summary { keyframes: None, ..summary() }, Errors::default());
        let page = RunPage { summary: &summary, errors: &errors, trajectory: &[], frames: &[], samples: &[] };
        assert!(page.html().unwrap().contains("seed 1 (as given to `report`)"));
    }
}
