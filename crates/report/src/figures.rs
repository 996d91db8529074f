//! The plots of a run.

use pfd_evaluation::{Ate, Rpe};
use pfd_geometry::{Stamp, StampedPose};

use crate::plot::{self, BLACK_LINE, COLOURS, LinePlot, Series};
use crate::{FrameRow, ReportError};

/// A pause in the poses longer than this (seconds) interrupts the curve.
const GAP: f64 = 0.5;
const TIMING_BINS: usize = 40;

/// Trajectory from above and from the side, aligned with the ground truth where there is one.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn trajectory(ate: Option<&Ate>, trajectory: &[StampedPose]) -> Result<Vec<String>, ReportError> {
    // With ground truth: its world, z up. Without: the first camera, x right, y down, z forward.
    let (views, curves): ([View; 2], Vec<(&str, Curve)>) = match ate {
        Some(ate) => (
            [("from above", [0, 1]), ("from the side", [0, 2])],
            vec![
                ("ground truth", ate.pairs.iter().map(|p| (p.stamp, p.ground_truth.coords.into())).collect()),
                ("estimate", ate.pairs.iter().map(|p| (p.stamp, p.estimate.coords.into())).collect()),
            ],
        ),
        None => (
            [("from above", [0, 2]), ("from behind", [0, 1])],
            vec![("estimate", trajectory.iter().map(|p| (p.stamp, p.pose.translation.vector.into())).collect())],
        ),
    };
    views.iter().map(|(name, axes)| view(name, *axes, &curves)).collect()
}

type Curve = Vec<(Stamp, [f64; 3])>;
/// Name of a view, and which coordinates it shows to the right and upwards.
type View = (&'static str, [usize; 2]);

fn view(name: &str, axes: [usize; 2], curves: &[(&str, Curve)]) -> Result<String, ReportError> {
    const AXES: [&str; 3] = ["x (m)", "y (m)", "z (m)"];
    let has_truth = curves.first().is_some_and(|(name, _)| *name == "ground truth");
    let colours = has_truth.then_some(BLACK_LINE).into_iter().chain(COLOURS.into_iter().cycle());
    let series = curves.iter().zip(colours).map(|((name, curve), colour)| Series {
        name: (*name).to_owned(),
        colour,
        points: interrupted(curve.iter().map(|&(stamp, p)| (stamp, (p[axes[0]], p[axes[1]])))),
    });
    plot::lines(&LinePlot {
        title: format!("Trajectory {name}"),
        x_label: AXES[axes[0]].to_owned(),
        y_label: AXES[axes[1]].to_owned(),
        series: series.collect(),
        equal_axes: true,
        from_zero: false,
    })
}

/// Runs of one sequence beside each other.
#[derive(Clone, Copy, Debug)]
pub struct Compared<'a> {
    /// Name of the variant.
    pub name: &'a str,
    /// Its errors.
    pub ate: &'a Ate,
    /// Its frames.
    pub frames: &'a [FrameRow],
}

/// Trajectories, errors over time, and histograms of errors and times of several runs of one sequence.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn comparison(runs: &[Compared<'_>]) -> Result<Vec<String>, ReportError> {
    let Some(first) = runs.first() else { return Ok(Vec::new()) };
    let truth: Curve = first.ate.pairs.iter().map(|p| (p.stamp, p.ground_truth.coords.into())).collect();
    let mut curves = vec![("ground truth", truth)];
    curves.extend(
        runs.iter().map(|run| {
            (run.name, run.ate.pairs.iter().map(|p| (p.stamp, p.estimate.coords.into())).collect::<Curve>())
        }),
    );
    let start = first.ate.pairs.first().map_or(Stamp::default(), |p| p.stamp);
    let error = |run: &Compared<'_>| {
        let points = run.ate.pairs.iter().map(|p| (p.stamp, (p.stamp.seconds_since(start), 100.0 * p.error())));
        interrupted(points)
    };
    let over_time = runs.iter().map(|run| (run.name, error(run))).collect();
    let values = |points: Vec<(f64, f64)>| points.into_iter().map(|(_, value)| (value, 0.0)).collect();
    let errors = coloured(runs.iter().map(|run| (run.name, values(error(run)))));
    let times = coloured(runs.iter().map(|run| (run.name, run.frames.iter().map(|f| (f.total_ms, 0.0)).collect())));
    Ok(vec![
        view("from above", [0, 1], &curves)?,
        time_plot("Absolute error (ATE)", "cm", over_time)?,
        plot::histogram("Absolute error (ATE)", "cm", &errors, TIMING_BINS)?,
        plot::histogram("Time per frame", "ms", &times, TIMING_BINS)?,
    ])
}

fn coloured<'a>(curves: impl Iterator<Item = (&'a str, Vec<(f64, f64)>)>) -> Vec<Series> {
    let series = |((name, points), colour): ((&str, _), _)| Series { name: name.to_owned(), colour, points };
    curves.zip(COLOURS.into_iter().cycle()).map(series).collect()
}

/// Absolute and relative error over time.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn errors(ate: &Ate, rpe: Option<&Rpe>) -> Result<Vec<String>, ReportError> {
    let Some(start) = ate.pairs.first().map(|p| p.stamp) else { return Ok(Vec::new()) };
    let over_time = |values: Vec<(Stamp, f64)>| {
        interrupted(values.into_iter().map(|(stamp, v)| (stamp, (stamp.seconds_since(start), v))))
    };
    let absolute = over_time(ate.pairs.iter().map(|p| (p.stamp, 100.0 * p.error())).collect());
    let mut plots = vec![time_plot("Absolute error (ATE)", "cm", vec![("error", absolute)])?];
    if let Some(rpe) = rpe {
        let relative = over_time(rpe.pairs.iter().map(|p| (p.start, 100.0 * p.translation)).collect());
        plots.push(time_plot("Drift over one second (RPE)", "cm/s", vec![("translation", relative)])?);
    }
    Ok(plots)
}

/// Time per frame: histogram and course.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn timing(frames: &[FrameRow]) -> Result<Vec<String>, ReportError> {
    let series = |name: &str, colour: usize, time: fn(&FrameRow) -> f64| Series {
        name: name.to_owned(),
        colour: COLOURS[colour],
        points: frames.iter().map(|f| (time(f), 0.0)).collect(),
    };
    let parts = [series("segmentation", 0, |f| f.segmentation_ms), series("tracking", 1, |f| f.tracking_ms)];
    let histogram = plot::histogram("Time per frame", "ms", &parts, TIMING_BINS)?;
    let course = |time: fn(&FrameRow) -> f64| over_frames(frames, time);
    let over_time = time_plot(
        "Time per frame",
        "ms",
        vec![("segmentation", course(|f| f.segmentation_ms)), ("tracking", course(|f| f.tracking_ms))],
    )?;
    Ok(vec![histogram, over_time])
}

/// Share of the image that is masked, and features that support the pose.
///
/// # Errors
/// When a plot cannot be drawn.
pub fn support(frames: &[FrameRow]) -> Result<Vec<String>, ReportError> {
    let masked = over_frames(frames, |f| 100.0 * f.mask_fraction);
    let features = over_frames(frames, |f| f64::from(f.features));
    let inliers = over_frames(frames, |f| f64::from(f.inliers));
    Ok(vec![
        time_plot("Image masked as moving", "%", vec![("masked", masked)])?,
        time_plot("Features outside the mask", "count", vec![("found", features), ("agree with the pose", inliers)])?,
    ])
}

fn time_plot(title: &str, unit: &str, curves: Vec<(&str, Vec<(f64, f64)>)>) -> Result<String, ReportError> {
    plot::lines(&LinePlot {
        title: title.to_owned(),
        x_label: "time (s)".to_owned(),
        y_label: unit.to_owned(),
        series: coloured(curves.into_iter()),
        equal_axes: false,
        from_zero: true,
    })
}

/// A column of `frames.csv` over the seconds since its first line.
fn over_frames(frames: &[FrameRow], value: fn(&FrameRow) -> f64) -> Vec<(f64, f64)> {
    let stamp = |f: &FrameRow| f.stamp.parse::<Stamp>().ok();
    let Some(start) = frames.first().and_then(stamp) else { return Vec::new() };
    let point = |f: &FrameRow| stamp(f).map(|s| (s.seconds_since(start), value(f)));
    frames.iter().filter_map(point).collect()
}

/// The points, with a NaN wherever time jumps.
fn interrupted(points: impl Iterator<Item = (Stamp, (f64, f64))>) -> Vec<(f64, f64)> {
    let mut curve = Vec::new();
    let mut last: Option<Stamp> = None;
    for (stamp, point) in points {
        if last.is_some_and(|l| stamp.seconds_since(l) > GAP) {
            curve.push((f64::NAN, f64::NAN));
        }
        curve.push(point);
        last = Some(stamp);
    }
    curve
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_in_time_interrupts() {
        let at = |ms: i64| (Stamp::from_nanos(ms * 1_000_000), (ms as f64, 0.0));
        let curve = interrupted([at(0), at(33), at(900)].into_iter());
        assert_eq!(curve.len(), 4);
        assert!(curve[2].0.is_nan());
    }
}
