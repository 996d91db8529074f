//! Outlines by colour: pixels along them go to what has their colours, the movers or what lies around these. Both are histograms of the
//! pixels that are not in question, and neighbours that look alike go together, as in Boykov and Jolly ("Interactive graph cuts", ICCV
//! 2001); the cut is relaxed to a mean field, as which label a few pixels get is no matter of optimality.
//!
//! Depth alone is ragged there, and grey levels alone place an outline wherever an edge is, be it that of a stripe on a shirt.
//!
//! All movers share one histogram. What is so narrow that all of it is in question goes by the colours of the others: mostly it is a
//! splinter of the background beside one of them.
//!
//! The log-odds below were compared on the sequences of the README: doubled or halved, each by itself changes their mean IoU by .005 at
//! most.

use pfd_geometry::RgbImage;

use super::regions::{BACKGROUND, neighbours};
use super::rim::Rim;
use super::view::{View, ViewFrame};

/// Bins of luma, and of each of the two differences of chroma.
const BINS: usize = 16;
/// Chroma beyond this is as good as this: surfaces in rooms seldom have more.
const MAX_CHROMA: i32 = 32;
/// Share of a bin that goes to each neighbour: colours of a surface differ by shading and noise, by about half a bin.
const LEAKAGE: f32 = 0.2;
/// Samples of any colour whatever that each side is taken to have besides those seen: what was seen of few pixels says little.
const UNSEEN: f32 = 10.0;
/// Log-odds that colour counts for at most.
const MAX_COLOUR: f32 = 2.0;
/// Log-odds by which a pixel keeps its label.
const KEEP_LABEL: f32 = 0.5;
/// Log-odds by which one that looks other than the static model is a mover's, and one that does not is none.
const BY_MODEL: f32 = 0.75;
/// Log-odds by which neighbours of the same grey level go together, …
const ALIKE: f32 = 0.8;
/// … and the difference of grey levels at which it is a third of that.
const CONTRAST: f32 = 16.0;
/// Log-odds that are certainty: between these a belief is linear in them, as the logistic function nearly is.
const CERTAIN: f32 = 2.0;
/// The surroundings are the box around all movers, grown by this, working pixels: of 320 columns a tenth.
const SURROUNDINGS: usize = 30;
/// Every how many pixels of a row, and rows, colours are counted.
const STRIDE: usize = 2;
/// Fewer samples than this are no histogram.
const MIN_SAMPLE: u32 = 10;
/// Turns of the relaxation, each there and back: with one more hardly any label changes.
const TURNS: usize = 3;

/// Decides along outlines.
#[derive(Debug, Default)]
pub(crate) struct Colours {
    rim: Rim,
    movers: Histogram,
    surroundings: Histogram,
    /// Log-odds that a colour is a mover's, by bin.
    odds: Vec<f32>,
    /// Pixels to decide.
    open: Vec<Open>,
    /// How surely a pixel is a mover's: −1 to 1.
    beliefs: Vec<f32>,
    labels: Vec<u16>,
}

/// A pixel to decide.
#[derive(Clone, Copy, Debug)]
struct Open {
    index: u32,
    /// Log-odds of being a mover's, neighbours aside.
    bias: f32,
    /// Its neighbours, and by how much it is like them; where there is none itself, and 0.
    around: [(u32, f32); 4],
}

impl Colours {
    /// Labels for all pixels: as given, but along outlines by the colours of `rgb`, an image of the camera's size, of which `frame` is the
    /// working view. `changed` says whether a pixel is other than in the static scene, where that is known.
    pub(crate) fn assign(
        &mut self,
        view: &View,
        (rgb, frame): (&RgbImage, &ViewFrame),
        changed: &[Option<bool>],
        labels: &[u16],
    ) -> &[u16] {
        self.labels.clear();
        self.labels.extend_from_slice(labels);
        let size = (view.camera.width, view.camera.height);
        let Some(window) = Window::around(size, labels) else { return &self.labels };
        self.rim.find(size.0, labels);
        self.rim.add_gaps(size, frame.depth.pixels());
        self.sample(view, rgb, labels, &window);
        if self.movers.count < MIN_SAMPLE || self.surroundings.count < MIN_SAMPLE {
            return &self.labels;
        }
        self.judge_colours();
        self.collect(view, (rgb, frame.gray.pixels()), changed, &window);
        self.relax();
        self.write_labels();
        &self.labels
    }

    /// Counts the colours of the pixels that are not in question.
    fn sample(&mut self, view: &View, rgb: &RgbImage, labels: &[u16], window: &Window) {
        self.movers.clear();
        self.surroundings.clear();
        let rim = self.rim.marks();
        for i in window.pixels(STRIDE).filter(|&i| !rim[i] && view.inside[i]) {
            let histogram = if labels[i] == BACKGROUND { &mut self.surroundings } else { &mut self.movers };
            histogram.add(bin(view.colour(rgb, i)));
        }
    }

    /// What each colour says.
    fn judge_colours(&mut self) {
        let shares = [&mut self.movers, &mut self.surroundings].map(Histogram::smoothed_shares);
        // The less colours tell both sides apart the less they say.
        let [movers, surroundings] = shares;
        let trust = distance(movers, surroundings);
        let odds = movers.iter().zip(surroundings).map(|(m, s)| trust * (m / s).ln().clamp(-MAX_COLOUR, MAX_COLOUR));
        self.odds.clear();
        self.odds.extend(odds);
    }

    /// Lists the pixels to decide.
    fn collect(&mut self, view: &View, (rgb, gray): (&RgbImage, &[u8]), changed: &[Option<bool>], window: &Window) {
        self.beliefs.clear();
        self.beliefs.extend(self.labels.iter().map(|&l| if l == BACKGROUND { -1.0 } else { 1.0 }));
        self.open.clear();
        let rim = self.rim.marks();
        let is_open = |&i: &usize| rim[i] && view.inside[i];
        for i in window.pixels(1).filter(is_open) {
            let seen = changed[i].map_or(0.0, |changed| if changed { BY_MODEL } else { -BY_MODEL });
            let colour = self.odds[usize::from(bin(view.colour(rgb, i)))];
            let bias = colour + KEEP_LABEL * self.beliefs[i] + seen;
            let tie = |j: Option<usize>| j.map_or((i as u32, 0.0), |j| (j as u32, likeness(gray[i], gray[j])));
            let around = neighbours((view.camera.width, view.camera.height), i).map(tie);
            self.open.push(Open { index: i as u32, bias, around });
        }
    }

    /// Brings each belief in line with the colour and with the neighbours.
    fn relax(&mut self) {
        let beliefs = &mut self.beliefs;
        let mut update = |open: &Open| {
            let pull: f32 = open.around.iter().map(|&(j, tie)| tie * beliefs[j as usize]).sum();
            beliefs[open.index as usize] = ((open.bias + pull) / CERTAIN).clamp(-1.0, 1.0);
        };
        for _ in 0..TURNS {
            self.open.iter().for_each(&mut update);
            self.open.iter().rev().for_each(&mut update);
        }
    }

    /// Gives pixels that became a mover's the label of the neighbour that is most like them, and the others that of the background.
    fn write_labels(&mut self) {
        let (beliefs, labels) = (&self.beliefs, &mut self.labels);
        for open in self.open.iter().filter(|open| beliefs[open.index as usize] <= 0.0) {
            labels[open.index as usize] = BACKGROUND;
        }
        let mut join = |open: &Open| {
            let i = open.index as usize;
            if beliefs[i] > 0.0 && labels[i] == BACKGROUND {
                let likest = |a: &(u32, f32), b: &(u32, f32)| a.1.total_cmp(&b.1);
                let labelled = open.around.iter().copied().filter(|&(j, _)| labels[j as usize] != BACKGROUND);
                labels[i] = labelled.max_by(likest).map_or(BACKGROUND, |(j, _)| labels[j as usize]);
            }
        };
        self.open.iter().for_each(&mut join);
        self.open.iter().rev().for_each(&mut join);
    }
}

/// A part of the working view.
#[derive(Clone, Copy, Debug)]
struct Window {
    columns: [usize; 2],
    rows: [usize; 2],
    width: usize,
}

impl Window {
    /// What surrounds all movers; `None` where there are none.
    fn around((width, height): (usize, usize), labels: &[u16]) -> Option<Self> {
        let is_mover = |l: &u16| *l != BACKGROUND;
        let (top, bottom) = (labels.iter().position(is_mover)? / width, labels.iter().rposition(is_mover)? / width);
        let ends = |row: &[u16]| Some([row.iter().position(is_mover)?, row.iter().rposition(is_mover)?]);
        let [left, right] =
            labels.chunks_exact(width).filter_map(ends).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
        let grown = |low: usize, high: usize, size: usize| {
            [low.saturating_sub(SURROUNDINGS), (high + SURROUNDINGS + 1).min(size)]
        };
        Some(Self { columns: grown(left, right, width), rows: grown(top, bottom, height), width })
    }

    /// Every `step`-th pixel of every `step`-th row.
    fn pixels(&self, step: usize) -> impl Iterator<Item = usize> + use<> {
        let ([left, right], [top, bottom], width) = (self.columns, self.rows, self.width);
        (top..bottom).step_by(step).flat_map(move |v| (left..right).step_by(step).map(move |u| v * width + u))
    }
}

/// How often colours occur.
#[derive(Clone, Debug, Default)]
struct Histogram {
    counts: Vec<f32>,
    spare: Vec<f32>,
    count: u32,
}

impl Histogram {
    fn clear(&mut self) {
        self.counts.clear();
        self.counts.resize(BINS * BINS * BINS, 0.0);
        self.count = 0;
    }

    fn add(&mut self, bin: u16) {
        self.counts[usize::from(bin)] += 1.0;
        self.count += 1;
    }

    /// Shares of the colours, each above 0, after each bin has leaked into its neighbours along each of the three axes.
    fn smoothed_shares(&mut self) -> &[f32] {
        for step in [1, BINS, BINS * BINS] {
            self.spare.clear();
            self.spare.extend(self.counts.iter().map(|c| (1.0 - 2.0 * LEAKAGE) * c));
            for (bin, &count) in self.counts.iter().enumerate().filter(|(_, c)| **c > 0.0) {
                let place = bin / step % BINS;
                // At the ends what would leave stays.
                self.spare[if place > 0 { bin - step } else { bin }] += LEAKAGE * count;
                self.spare[if place + 1 < BINS { bin + step } else { bin }] += LEAKAGE * count;
            }
            std::mem::swap(&mut self.counts, &mut self.spare);
        }
        let even = UNSEEN / self.counts.len() as f32;
        let scale = 1.0 / (self.count as f32 + UNSEEN);
        self.counts.iter_mut().for_each(|count| *count = (*count + even) * scale);
        &self.counts
    }
}

/// Total variation distance of two distributions: 0 where they are the same, 1 where they share no colour.
fn distance(a: &[f32], b: &[f32]) -> f32 {
    0.5 * a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f32>()
}

/// Bin of a colour: luma, then the differences of blue and red from it (ITU-R BT.601, in fixed point).
fn bin([r, g, b]: [u8; 3]) -> u16 {
    let [r, g, b] = [r, g, b].map(i32::from);
    let luma = (77 * r + 150 * g + 29 * b) >> 8;
    let blue = (-43 * r - 85 * g + 128 * b) >> 8;
    let red = (128 * r - 107 * g - 21 * b) >> 8;
    let bins = BINS as i32;
    let of_chroma = |c: i32| ((c + MAX_CHROMA) * bins / (2 * MAX_CHROMA)).clamp(0, bins - 1);
    ((luma * bins / 256 * bins + of_chroma(blue)) * bins + of_chroma(red)) as u16
}

/// By how much two neighbours with these grey levels go together.
fn likeness(a: u8, b: u8) -> f32 {
    let difference = f32::from(a.abs_diff(b)) / CONTRAST;
    ALIKE * (-difference * difference).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::rim::RIM_WIDTH;

    use pfd_geometry::{Camera, Distortion, GrayImage, Image};

    const WIDTH: usize = 64;
    const HEIGHT: usize = 48;
    /// Columns from here on belong to a mover.
    const EDGE: usize = 32;
    const RED: [u8; 3] = [180, 60, 60];
    const GREEN: [u8; 3] = [60, 180, 60];

    fn view() -> View {
        let (width, height) = (WIDTH, HEIGHT);
        let (cx, cy) = (31.5, 23.5);
        View::new(&Camera { width, height, fx: 60.0, fy: 60.0, cx, cy, distortion: Distortion::default() })
    }

    fn labels(is_mover: impl Fn(usize, usize) -> bool) -> Vec<u16> {
        (0..WIDTH * HEIGHT).map(|i| u16::from(is_mover(i % WIDTH, i / WIDTH))).collect()
    }

    /// What becomes of labels in an image of one colour where `is_mover` holds and of another one elsewhere.
    fn assigned(is_mover: impl Fn(usize, usize) -> bool, [mover, room]: [[u8; 3]; 2], given: &[u16]) -> Vec<u16> {
        let mut rgb = Image::filled(WIDTH, HEIGHT, room);
        for i in (0..WIDTH * HEIGHT).filter(|i| is_mover(i % WIDTH, i / WIDTH)) {
            rgb.pixels_mut()[i] = mover;
        }
        let frame = ViewFrame { gray: rgb.to_gray(), depth: Image::filled(WIDTH, HEIGHT, 2.0) };
        Colours::default().assign(&view(), (&rgb, &frame), &[None; WIDTH * HEIGHT], given).to_vec()
    }

    /// Column of the mover's first pixel in each row.
    fn edges(labels: &[u16]) -> Vec<usize> {
        labels.chunks_exact(WIDTH).map(|row| row.iter().take_while(|l| **l == BACKGROUND).count()).collect()
    }

    #[test]
    fn an_outline_moves_to_where_colours_change() {
        let is_mover = |u: usize, _| u >= EDGE;
        for off in [EDGE - 2, EDGE, EDGE + 2] {
            let found = assigned(is_mover, [RED, GREEN], &labels(|u, _| u >= off));
            assert_eq!(edges(&found), [EDGE; HEIGHT], "given at {off}");
        }
    }

    #[test]
    fn the_static_scene_decides_where_colours_do_not() {
        let given = labels(|u, _| u >= EDGE);
        // Black and white in turn, in both directions, so that no two neighbours are alike.
        let mut rgb = Image::filled(WIDTH, HEIGHT, [255; 3]);
        let odd = (0..WIDTH * HEIGHT).filter(|i| (i % WIDTH + i / WIDTH) % 2 == 1);
        odd.for_each(|i| rgb.pixels_mut()[i] = [0; 3]);
        let frame = ViewFrame { gray: rgb.to_gray(), depth: Image::filled(WIDTH, HEIGHT, 2.0) };
        let edge = |seen: Option<bool>| {
            let found = Colours::default().assign(&view(), (&rgb, &frame), &[seen; WIDTH * HEIGHT], &given).to_vec();
            edges(&found)[HEIGHT / 2]
        };
        assert_eq!([None, Some(true), Some(false)].map(edge), [EDGE, EDGE - RIM_WIDTH, EDGE + RIM_WIDTH]);
    }

    #[test]
    fn a_gap_beside_a_mover_goes_to_what_has_its_colours() {
        let is_mover = |u: usize, _| u >= EDGE;
        let mut rgb = Image::filled(WIDTH, HEIGHT, GREEN);
        let mut frame = ViewFrame { gray: GrayImage::default(), depth: Image::filled(WIDTH, HEIGHT, 2.0) };
        for i in 0..WIDTH * HEIGHT {
            if is_mover(i % WIDTH, 0) {
                rgb.pixels_mut()[i] = RED;
            }
            if (EDGE - 3..EDGE + 8).contains(&(i % WIDTH)) {
                frame.depth.pixels_mut()[i] = 0.0;
            }
        }
        frame.gray = rgb.to_gray();
        let given = labels(|u, _| u >= EDGE + 8);
        let found = Colours::default().assign(&view(), (&rgb, &frame), &[None; WIDTH * HEIGHT], &given).to_vec();
        assert_eq!(edges(&found), [EDGE; HEIGHT]);
    }

    #[test]
    fn what_is_far_from_an_outline_stays_whatever_its_colour() {
        // A green patch in the middle of the mover, and a red one away from it.
        let is_red = |u: usize, v: usize| {
            let patch = |left: usize| (left..left + 4).contains(&u) && (20..24).contains(&v);
            (u >= EDGE && !patch(50)) || patch(10)
        };
        let given = labels(|u, _| u >= EDGE);
        assert!(assigned(is_red, [RED, GREEN], &given) == given);
    }

    #[test]
    fn labels_stay_where_both_sides_have_the_same_colour() {
        let given = labels(|u, _| u >= EDGE);
        assert!(assigned(|_, _| true, [RED, RED], &given) == given);
    }

    #[test]
    fn a_pixel_that_joins_a_mover_gets_the_label_beside_it() {
        let is_mover = |u: usize, v: usize| u >= EDGE && !(20..26).contains(&v);
        let of = |v: usize| if v < 23 { 1 } else { 2 };
        let late = |u: usize, v: usize| u >= EDGE + 2 && is_mover(u, v);
        let given: Vec<u16> =
            labels(late).iter().enumerate().map(|(i, &l)| if l == BACKGROUND { l } else { of(i / WIDTH) }).collect();
        let found = assigned(is_mover, [RED, GREEN], &given);
        let expected = |i: usize| if is_mover(i % WIDTH, i / WIDTH) { of(i / WIDTH) } else { BACKGROUND };
        let wrong = (0..found.len()).filter(|&i| found[i] != expected(i)).count();
        assert_eq!(wrong, 0);
    }

    #[test]
    fn what_too_little_is_seen_of_keeps_its_labels() {
        // A strip so narrow that all of it is in question, in the colour of what lies around it.
        let strip = |u: usize| (EDGE..EDGE + 2 * RIM_WIDTH).contains(&u);
        for mover_is_narrow in [true, false] {
            let given = labels(|u, _| strip(u) == mover_is_narrow);
            assert!(assigned(|_, _| true, [RED, RED], &given) == given, "{mover_is_narrow}");
        }
    }

    #[test]
    fn a_speckle_goes_with_what_surrounds_it_if_it_is_as_bright() {
        let [bright, dull] = [GREEN, [60, 127, 60]];
        let is_mover = |speckle: [u8; 3], room: [u8; 3]| {
            let mut rgb = Image::filled(WIDTH, HEIGHT, room);
            (0..WIDTH * HEIGHT).filter(|i| i % WIDTH >= EDGE).for_each(|i| rgb.pixels_mut()[i] = RED);
            let at = 20 * WIDTH + EDGE + 1;
            rgb.pixels_mut()[at] = speckle;
            let frame = ViewFrame { gray: rgb.to_gray(), depth: Image::filled(WIDTH, HEIGHT, 2.0) };
            let given = labels(|u, _| u >= EDGE);
            Colours::default().assign(&view(), (&rgb, &frame), &[None; WIDTH * HEIGHT], &given)[at] != BACKGROUND
        };
        assert!(is_mover(dull, dull));
        assert!(!is_mover(bright, bright));
    }

    fn histogram(colours: &[([u8; 3], usize)]) -> Histogram {
        let mut histogram = Histogram::default();
        histogram.clear();
        for &(colour, times) in colours {
            (0..times).for_each(|_| histogram.add(bin(colour)));
        }
        histogram
    }

    #[test]
    fn shares_add_up_and_leak_to_neighbours_alone() {
        let (middle, corner) = ([128; 3], [0; 3]);
        let mut histogram = histogram(&[(middle, 800), (corner, 200)]);
        let shares = histogram.smoothed_shares();
        assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-4);
        assert!(shares.iter().all(|share| *share > 0.0));
        let (kept, seen) = (1.0 - 2.0 * LEAKAGE, 1000.0 / (1000.0 + UNSEEN));
        let at = usize::from(bin(middle));
        assert!((shares[at] - 0.8 * seen * kept.powi(3)).abs() < 1e-4);
        assert!((shares[at + 1] - 0.8 * seen * LEAKAGE * kept.powi(2)).abs() < 1e-4);
        assert!(shares[at + 2] < 1e-4);
        assert!((shares[usize::from(bin(corner))] - 0.2 * seen * (1.0 - LEAKAGE) * kept.powi(2)).abs() < 1e-3);
    }

    #[test]
    fn distributions_are_as_far_apart_as_they_differ() {
        assert_eq!(distance(&[0.5, 0.5, 0.0], &[0.5, 0.5, 0.0]), 0.0);
        assert_eq!(distance(&[0.5, 0.5, 0.0], &[0.25, 0.5, 0.25]), 0.25);
        assert_eq!(distance(&[1.0, 0.0, 0.0], &[0.0, 0.5, 0.5]), 1.0);
    }

    #[test]
    fn little_is_made_of_few_samples() {
        let apart = |times: usize| {
            let [mut red, mut green] = [histogram(&[(RED, times)]), histogram(&[(GREEN, times)])];
            distance(red.smoothed_shares(), green.smoothed_shares())
        };
        assert!((apart(UNSEEN as usize) - 0.5).abs() < 1e-3);
        assert!(apart(1000) > 0.95);
    }

    #[test]
    fn colours_of_both_sides_say_little() {
        // All colours but one are those of both sides; that one was seen on the mover alone.
        let given = labels(|u, _| u >= EDGE);
        let edge = |patch: usize| {
            let mut rgb = Image::filled(WIDTH, HEIGHT, RED);
            let is_green = |i: &usize| i % WIDTH >= WIDTH - patch || i % WIDTH == EDGE - 1;
            (0..WIDTH * HEIGHT).filter(is_green).for_each(|i| rgb.pixels_mut()[i] = GREEN);
            let frame = ViewFrame { gray: rgb.to_gray(), depth: Image::filled(WIDTH, HEIGHT, 2.0) };
            edges(Colours::default().assign(&view(), (&rgb, &frame), &[None; WIDTH * HEIGHT], &given))[HEIGHT / 2]
        };
        assert_eq!([2, 16].map(edge), [EDGE, EDGE - 1]);
    }

    #[test]
    fn every_colour_has_a_bin() {
        let levels = [0, 1, 127, 128, 254, 255];
        for r in levels {
            for g in levels {
                for b in levels {
                    assert!((bin([r, g, b]) as usize) < BINS * BINS * BINS);
                }
            }
        }
        assert_ne!(bin(RED), bin(GREEN));
        assert_ne!(bin([100; 3]), bin([140; 3]), "luma counts");
    }
}
