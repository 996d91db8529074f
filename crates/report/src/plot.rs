//! Plots as SVG text.

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use crate::ReportError;

/// Size of a plot in SVG units; pages scale it to their width. Text is large so that it stays readable on a phone.
const SIZE: (u32, u32) = (720, 460);
const TITLE_SIZE: u32 = 24;
const TEXT_SIZE: u32 = 19;
/// Space kept free around the data, as a share of its extent.
const MARGIN: f64 = 0.06;

/// Colours told apart by colour-blind readers too (Okabe and Ito).
pub const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];
/// Colour of ground truth.
pub const BLACK_LINE: RGBColor = RGBColor(60, 60, 60);

/// A curve.
#[derive(Clone, Debug)]
pub struct Series {
    /// Text of the legend.
    pub name: String,
    /// Colour of the curve.
    pub colour: RGBColor,
    /// Points in the units of the axes; a NaN interrupts the curve.
    pub points: Vec<(f64, f64)>,
}

/// A plot of curves.
#[derive(Clone, Debug)]
pub struct LinePlot {
    /// Title above the plot.
    pub title: String,
    /// Name and unit of the horizontal axis.
    pub x_label: String,
    /// Name and unit of the vertical axis.
    pub y_label: String,
    /// The curves.
    pub series: Vec<Series>,
    /// Whether a unit has the same length on both axes.
    pub equal_axes: bool,
    /// Whether the vertical axis begins at 0.
    pub from_zero: bool,
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type DrawResult<T = ()> = Result<T, String>;

/// Draws curves.
///
/// # Errors
/// [`ReportError::Plot`] when the drawing library refuses.
pub fn lines(plot: &LinePlot) -> Result<String, ReportError> {
    svg(&plot.title, |area| draw_lines(area, plot))
}

/// Draws how often values fall into each of `bins` equal intervals from 0 to the largest value.
///
/// # Errors
/// [`ReportError::Plot`] when the drawing library refuses.
pub fn histogram(title: &str, x_label: &str, series: &[Series], bins: usize) -> Result<String, ReportError> {
    svg(title, |area| draw_histogram(area, title, x_label, series, bins))
}

fn svg(title: &str, draw: impl FnOnce(&Area<'_>) -> DrawResult) -> Result<String, ReportError> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
    let drawn =
        area.fill(&WHITE).map_err(message).and_then(|()| draw(&area)).and_then(|()| area.present().map_err(message));
    drop(area);
    drawn.map_err(|reason| ReportError::Plot { title: title.to_owned(), reason })?;
    Ok(text)
}

fn message(error: impl std::fmt::Display) -> String {
    error.to_string()
}

fn draw_lines(area: &Area<'_>, plot: &LinePlot) -> DrawResult {
    let finite = |&&(x, y): &&(f64, f64)| x.is_finite() && y.is_finite();
    let points: Vec<(f64, f64)> = plot.series.iter().flat_map(|s| s.points.iter().filter(finite)).copied().collect();
    let mut x = range(points.iter().map(|p| p.0));
    let mut y = range(points.iter().map(|p| p.1));
    if plot.from_zero {
        y.0 = 0.0;
    }
    if plot.equal_axes {
        (x, y) = with_equal_scale(x, y);
    }
    let mut chart = axes(area, &plot.title, (&plot.x_label, &plot.y_label), x, y)?;
    for series in &plot.series {
        let style = series.colour.stroke_width(2);
        for part in series.points.split(|(x, y)| !x.is_finite() || !y.is_finite()).filter(|part| !part.is_empty()) {
            chart.draw_series(LineSeries::new(part.iter().copied(), style)).map_err(message)?;
        }
        label(&mut chart, series)?;
    }
    legend(&mut chart)
}

fn draw_histogram(area: &Area<'_>, title: &str, x_label: &str, series: &[Series], bins: usize) -> DrawResult {
    let bins = bins.max(1);
    let largest = series.iter().flat_map(|s| s.points.iter().map(|p| p.0)).fold(f64::MIN_POSITIVE, f64::max);
    let width = largest / bins as f64;
    let counts: Vec<Vec<f64>> = series.iter().map(|s| count(s, width, bins)).collect();
    let highest = counts.iter().flatten().fold(1.0_f64, |a, &b| a.max(b));
    let mut chart = axes(area, title, (x_label, "frames"), (0.0, largest), (0.0, highest * (1.0 + MARGIN)))?;
    for (series, counts) in series.iter().zip(&counts) {
        let bars = counts.iter().enumerate().filter(|(_, n)| **n > 0.0).map(|(i, &n)| {
            let corners = [(i as f64 * width, 0.0), ((i + 1) as f64 * width, n)];
            Rectangle::new(corners, series.colour.mix(0.55).filled())
        });
        chart.draw_series(bars).map_err(message)?;
        label(&mut chart, series)?;
    }
    legend(&mut chart)
}

/// How many values of a series (the x of its points) fall into each bin.
fn count(series: &Series, width: f64, bins: usize) -> Vec<f64> {
    let mut counts = vec![0.0; bins];
    for (value, _) in series.points.iter().filter(|p| p.0.is_finite()) {
        counts[((value / width) as usize).min(bins - 1)] += 1.0;
    }
    counts
}

fn axes<'a, 'b>(
    area: &'a Area<'b>,
    title: &str,
    (x_label, y_label): (&str, &str),
    x: (f64, f64),
    y: (f64, f64),
) -> DrawResult<Chart<'a, 'b>> {
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", TITLE_SIZE))
        .margin(12)
        .x_label_area_size(50)
        .y_label_area_size(78)
        .build_cartesian_2d(x.0..x.1, y.0..y.1)
        .map_err(message)?;
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(x_label)
        .y_desc(y_label)
        .label_style(("sans-serif", TEXT_SIZE))
        .axis_desc_style(("sans-serif", TEXT_SIZE));
    mesh.x_labels(7).y_labels(6).light_line_style(WHITE).bold_line_style(RGBColor(225, 225, 225));
    mesh.x_label_formatter(&tick(x)).y_label_formatter(&tick(y)).draw().map_err(message)?;
    Ok(chart)
}

/// Ticks with as many decimals as the range needs.
fn tick((low, high): (f64, f64)) -> impl Fn(&f64) -> String {
    let decimals = (1.0 - (high - low).max(f64::MIN_POSITIVE).log10()).ceil().clamp(0.0, 6.0) as usize;
    move |value| format!("{value:.decimals$}")
}

fn label(chart: &mut Chart<'_, '_>, series: &Series) -> DrawResult {
    let style = series.colour.stroke_width(4);
    chart
        .draw_series(std::iter::once(PathElement::new(Vec::new(), style)))
        .map_err(message)?
        .label(series.name.clone())
        .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 22, y)], style));
    Ok(())
}

fn legend<'a, 'b: 'a>(chart: &mut Chart<'a, 'b>) -> DrawResult {
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font(("sans-serif", TEXT_SIZE))
        .legend_area_size(34)
        .background_style(WHITE.mix(0.8))
        .border_style(RGBColor(200, 200, 200))
        .draw()
        .map_err(message)
}

/// Extent of the values with a margin; never empty.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    let margin = ((high - low) * MARGIN).max(1e-3);
    (low - margin, high + margin)
}

/// Widens one of the ranges so that a unit has the same length on both axes.
fn with_equal_scale(x: (f64, f64), y: (f64, f64)) -> ((f64, f64), (f64, f64)) {
    // Width and height of the plot without labels and title.
    let (width, height) = (f64::from(SIZE.0) - 102.0, f64::from(SIZE.1) - 108.0);
    let unit = ((x.1 - x.0) / width).max((y.1 - y.0) / height);
    let widened = |(low, high): (f64, f64), length: f64| {
        let (middle, half) = (f64::midpoint(low, high), unit * length / 2.0);
        (middle - half, middle + half)
    };
    (widened(x, width), widened(y, height))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(points: Vec<(f64, f64)>) -> Series {
        Series { name: "a < b".to_owned(), colour: COLOURS[0], points }
    }

    #[test]
    fn a_gap_interrupts_the_curve() {
        let points = vec![(0.0, 0.0), (1.0, 1.0), (f64::NAN, 0.0), (2.0, 1.0), (3.0, 0.0)];
        let plot = LinePlot {
            title: "t".into(),
            x_label: "x".into(),
            y_label: "y".into(),
            series: vec![series(points)],
            equal_axes: true,
            from_zero: false,
        };
        let svg = lines(&plot).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("a &lt; b") && !svg.contains("NaN"));
        let empty = LinePlot { series: vec![], ..plot };
        assert!(lines(&empty).unwrap().contains("</svg>"));
    }

    #[test]
    fn histogram_counts() {
        let values = series(vec![(1.0, 0.0), (1.2, 0.0), (9.9, 0.0), (10.0, 0.0)]);
        assert_eq!(count(&values, 1.0, 10), [0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]);
        assert!(histogram("t", "ms", &[values], 10).is_ok());
        assert!(histogram("t", "ms", &[], 0).is_ok());
    }

    #[test]
    fn equal_scale_keeps_the_data_inside() {
        let (x, y) = with_equal_scale((0.0, 10.0), (0.0, 1.0));
        assert!(x.0 <= 1e-9 && x.1 >= 10.0 - 1e-9 && y.0 < 0.0 && y.1 > 1.0);
    }
}
