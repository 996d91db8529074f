//! `bench.html`: tables, then plots and sample frames of every sequence.

use crate::bench::{BenchRun, sequences};
use crate::bench_tables::tables;
use crate::figures::{Compared, comparison};
use crate::summary::Errors;
use crate::{FrameRow, ReportError, Sample, html};

/// One run in detail: the one with the median error of its variant.
#[derive(Clone, Debug)]
pub struct Detail {
    /// Name of the sequence.
    pub sequence: String,
    /// Name of the variant.
    pub variant: String,
    /// Errors over time.
    pub errors: Errors,
    /// One row a frame.
    pub frames: Vec<FrameRow>,
    /// Sample frames with masks.
    pub samples: Vec<Sample>,
}

/// The text of the page.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn page(runs: &[BenchRun], details: &[Detail]) -> Result<String, ReportError> {
    let mut body: String = tables(runs).iter().map(crate::table::Table::html).collect();
    for sequence in sequences(runs) {
        let here: Vec<&Detail> = details.iter().filter(|d| d.sequence == sequence).collect();
        body += &html::section(sequence, &(html::plots(&plots(&here)?) + &contact_sheets(&here)));
    }
    Ok(html::page("PFD-SLAM: bench", &body))
}

fn plots(details: &[&Detail]) -> Result<Vec<String>, ReportError> {
    let runs: Vec<Compared<'_>> = details
        .iter()
        .filter_map(|d| Some(Compared { name: &d.variant, ate: d.errors.ate.as_ref()?, frames: &d.frames }))
        .collect();
    comparison(&runs)
}

fn contact_sheets(details: &[&Detail]) -> String {
    let sheet = |detail: &&Detail| {
        let title = html::escape(&format!("What {} takes to move", detail.variant));
        format!("<h3>{title}</h3>\n{}", html::samples(&detail.samples))
    };
    details.iter().filter(|d| !d.samples.is_empty()).map(sheet).collect()
}
