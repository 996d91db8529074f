//! One picture of a run: a frame with its mask beside the trajectory.

use std::fmt::Write;

use crate::html::escape;
use crate::summary::Errors;
use crate::{ReportError, Sample, Summary, figures};

/// Size of the picture and its parts, SVG units.
const WIDTH: u32 = 1280;
const HEIGHT: u32 = 450;
const PANEL: u32 = 560;
const PLOT_X: u32 = 590;
const PLOT_WIDTH: u32 = 660;
const TOP: u32 = 14;

/// The picture as SVG that needs no other file.
///
/// # Errors
/// When the plot cannot be drawn.
pub fn svg(
    summary: &Summary,
    errors: &Errors,
    trajectory: &[pfd_geometry::StampedPose],
    sample: &Sample,
) -> Result<String, ReportError> {
    let plot = figures::trajectory(errors.ate.as_ref(), trajectory)?.into_iter().next().unwrap_or_default();
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" xmlns:xlink=\"http://www.w3.org/1999/xlink\" \
         viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
    );
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "<image x=\"14\" y=\"{TOP}\" width=\"{PANEL}\" height=\"{HEIGHT}\" preserveAspectRatio=\"xMinYMin meet\" xlink:href=\"{}\"/>",
        sample.data_uri()
    );
    let nested = plot.replacen("<svg ", &format!("<svg x=\"{PLOT_X}\" y=\"{TOP}\" "), 1);
    let nested = nested.replacen("width=\"720\" height=\"460\"", &format!("width=\"{PLOT_WIDTH}\" height=\"421\""), 1);
    text += &nested;
    Ok(text + &caption(summary) + "</svg>\n")
}

fn caption(s: &Summary) -> String {
    let error = s.ate.map_or(String::new(), |ate| format!(", ATE {:.1} cm", 100.0 * ate.rmse));
    let line = format!("{}: {:.1} % of {} frames tracked{error}", s.sequence, 100.0 * s.tracked, s.frames);
    format!(
        "<text x=\"{PLOT_X}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"17\" fill=\"#444444\">{}</text>\n",
        HEIGHT - 6,
        escape(&line)
    )
}
