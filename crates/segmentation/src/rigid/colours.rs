//! Outlines by colour: pixels along them go to what has their colours, the movers or what lies around these. Both are histograms of the
//! pixels that are not in question, and neighbours that look alike go together, as in Boykov and Jolly ("Interactive graph cuts", ICCV
//! 2001); the cut is relaxed to a mean field, as which label a few pixels get is no matter of optimality.
//!
//! Depth alone is ragged there, and grey levels alone place an outline wherever an edge is, be it that of a stripe on a shirt.

use pfd_geometry::RgbImage;

use super::regions::BACKGROUND;
use super::rim::Rim;
use super::view::{View, ViewFrame};

/// Bins of luma, and of each of the two differences of chroma.
const BINS: usize = 16;
/// Chroma beyond this is as good as this: surfaces in rooms seldom have more.
const MAX_CHROMA: i32 = 32;
/// Share of a bin that goes to each neighbour: colours of a surface differ by shading and noise.
const LEAKAGE: f32 = 0.2;
/// Share of pixels of which the colour says nothing: reflections, blends of both sides.
const UNRELIABLE: f32 = 0.01;
/// Log-odds that colour counts for at most.
const MAX_COLOUR: f32 = 2.0;
/// Log-odds by which a pixel stays what it was found to be.
const AS_FOUND: f32 = 0.5;
/// Log-odds by which one that looks other than the static model is a mover's, and one that does not is none.
const BY_MODEL: f32 = 0.75;
/// Log-odds by which neighbours of the same grey level go together, …
const ALIKE: f32 = 0.8;
/// … and the difference of grey levels at which it is a third of that.
const CONTRAST: f32 = 16.0;
/// Log-odds that are certainty: between these a belief is linear in them, as the logistic function nearly is.
const CERTAIN: f32 = 2.0;
/// Movers are compared with what lies up to this far from them, working pixels: a tenth of the width.
const SURROUNDINGS: usize = 30;
/// Every how many pixels of a row, and rows, colours are counted.
const STRIDE: usize = 2;
/// Fewer pixels than this have no histogram.
const MIN_SAMPLE: u32 = 10;
/// Turns of the relaxation, each there and back; after two hardly any label changes.
const TURNS: usize = 3;

/// Decides along outlines.
#[derive(Debug, Default)]
pub(crate) struct Colours {
    rim: Rim,
    movers: Histogram,
    surroundings: Histogram,
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
    /// For each of up to four neighbours by how much it is like them: left, right, above, below.
    ties: [f32; 4],
}

impl Colours {
    /// Labels for all pixels: as given, but along outlines by the colours of `rgb`, an image of the camera's size; `frame` is the same in the
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
        let (width, height) = (view.camera.width, view.camera.height);
        let Some(window) = Window::around(width, height, labels) else { return &self.labels };
        self.rim.find(width, labels);
        self.rim.add_gaps(width, frame.depth.pixels());
        self.sample(view, rgb, labels, &window);
        if self.movers.count < MIN_SAMPLE || self.surroundings.count < MIN_SAMPLE {
            return &self.labels;
        }
        self.collect(view, (rgb, frame.gray.pixels()), changed, &window);
        self.relax(width);
        self.settle(width);
        &self.labels
    }

    /// Counts the colours of the pixels that are not in question.
    fn sample(&mut self, view: &View, rgb: &RgbImage, labels: &[u16], window: &Window) {
        self.movers.clear();
        self.surroundings.clear();
        let rim = self.rim.marks();
        for i in window.pixels(STRIDE).filter(|&i| !rim[i]) {
            let histogram = if labels[i] == BACKGROUND { &mut self.surroundings } else { &mut self.movers };
            histogram.add(bin(view.colour(rgb, i)));
        }
        self.movers.smooth();
        self.surroundings.smooth();
    }

    /// Lists the pixels to decide.
    fn collect(
        &mut self,
        view: &View,
        (rgb, gray): (&RgbImage, &[u8]),
        changed: &[Option<bool>],
        window: &Window,
    ) {
        // The less colours tell both sides apart the less they say.
        let trust = self.movers.distance(&self.surroundings);
        self.beliefs.clear();
        self.beliefs.extend(self.labels.iter().map(|&l| if l == BACKGROUND { -1.0 } else { 1.0 }));
        self.open.clear();
        for i in window.pixels(1).filter(|&i| self.rim.marks()[i]) {
            let bin = bin(view.colour(rgb, i));
            let colour = (self.movers.share(bin) / self.surroundings.share(bin)).ln();
            let seen = changed[i].map_or(0.0, |changed| if changed { BY_MODEL } else { -BY_MODEL });
            let bias = trust * colour.clamp(-MAX_COLOUR, MAX_COLOUR) + AS_FOUND * self.beliefs[i] + seen;
            let tie = |j: Option<usize>| j.map_or(0.0, |j| likeness(gray[i], gray[j]));
            let ties = neighbours(i, (window.width, window.height)).map(tie);
            self.open.push(Open { index: i as u32, bias, ties });
        }
    }

    /// Brings each belief in line with the colour and with the neighbours.
    fn relax(&mut self, width: usize) {
        let beliefs = &mut self.beliefs;
        let mut update = |open: &Open| {
            let i = open.index as usize;
            // Where there is no neighbour, the tie to whatever stands in its place is 0.
            let around = [i.wrapping_sub(1), i + 1, i.wrapping_sub(width), i + width];
            let pull = |(j, tie): (usize, f32)| tie * beliefs.get(j).copied().unwrap_or(0.0);
            let odds = open.bias + around.into_iter().zip(open.ties).map(pull).sum::<f32>();
            beliefs[i] = (odds / CERTAIN).clamp(-1.0, 1.0);
        };
        for _ in 0..TURNS {
            self.open.iter().for_each(&mut update);
            self.open.iter().rev().for_each(&mut update);
        }
    }

    /// Gives pixels that became a mover's the label beside them, and the others that of the background.
    fn settle(&mut self, width: usize) {
        let (beliefs, labels) = (&self.beliefs, &mut self.labels);
        let mut update = |open: &Open| {
            let i = open.index as usize;
            if beliefs[i] <= 0.0 {
                labels[i] = BACKGROUND;
            } else if labels[i] == BACKGROUND {
                let around = [i.wrapping_sub(1), i + 1, i.wrapping_sub(width), i + width];
                let tied = around.into_iter().zip(open.ties).filter(|(_, tie)| *tie > 0.0);
                let label = tied.map(|(j, _)| labels[j]).find(|&label| label != BACKGROUND);
                labels[i] = label.unwrap_or(BACKGROUND);
            }
        };
        self.open.iter().for_each(&mut update);
        self.open.iter().rev().for_each(&mut update);
    }
}

/// A part of the working view.
#[derive(Clone, Copy, Debug)]
struct Window {
    columns: [usize; 2],
    rows: [usize; 2],
    width: usize,
    height: usize,
}

impl Window {
    /// What surrounds all movers; `None` where there are none.
    fn around(width: usize, height: usize, labels: &[u16]) -> Option<Self> {
        let is_mover = |l: &u16| *l != BACKGROUND;
        let first = labels.iter().position(is_mover)? / width;
        let last = labels.iter().rposition(is_mover)? / width;
        let of_row = |row: &[u16]| Some([row.iter().position(is_mover)?, row.iter().rposition(is_mover)?]);
        let [left, right] = labels
            .chunks_exact(width)
            .filter_map(of_row)
            .reduce(|[left, right], [first, last]| [left.min(first), right.max(last)])?;
        let grown = |low: usize, high: usize, size: usize| {
            [low.saturating_sub(SURROUNDINGS), (high + SURROUNDINGS + 1).min(size)]
        };
        Some(Self { columns: grown(left, right, width), rows: grown(first, last, height), width, height })
    }

    /// Every `step`-th of every `step`-th row.
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
        self.counts[bin as usize] += 1.0;
        self.count += 1;
    }

    /// Lets each bin leak into its neighbours along each of the three axes.
    fn smooth(&mut self) {
        for step in [1, BINS, BINS * BINS] {
            self.spare.clear();
            self.spare.extend(self.counts.iter().map(|c| (1.0 - 2.0 * LEAKAGE) * c));
            for (bin, &count) in self.counts.iter().enumerate() {
                let place = bin / step % BINS;
                // At the ends what would leave stays.
                self.spare[if place > 0 { bin - step } else { bin }] += LEAKAGE * count;
                self.spare[if place + 1 < BINS { bin + step } else { bin }] += LEAKAGE * count;
            }
            std::mem::swap(&mut self.counts, &mut self.spare);
        }
    }

    /// Total variation distance from another histogram: 0 where both are the same, 1 where they share no colour.
    fn distance(&self, other: &Self) -> f32 {
        let [a, b] = [self, other].map(|h| 1.0 / h.count as f32);
        0.5 * self.counts.iter().zip(&other.counts).map(|(x, y)| (x * a - y * b).abs()).sum::<f32>()
    }

    /// Share of a bin, above 0.
    fn share(&self, bin: u16) -> f32 {
        let even = 1.0 / self.counts.len() as f32;
        (1.0 - UNRELIABLE) * self.counts[bin as usize] / self.count as f32 + UNRELIABLE * even
    }
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

/// The neighbours of a pixel: left, right, above, below.
fn neighbours(i: usize, (width, height): (usize, usize)) -> [Option<usize>; 4] {
    let (u, v) = (i % width, i / width);
    [
        (u > 0).then(|| i - 1),
        (u + 1 < width).then(|| i + 1),
        (v > 0).then(|| i - width),
        (v + 1 < height).then(|| i + width),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

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

    /// Column of the last pixel before the mover in each row.
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
        // A chequered scene: no two neighbours are alike.
        let mut rgb = Image::filled(WIDTH, HEIGHT, RED);
        let odd = (0..WIDTH * HEIGHT).filter(|i| (i % WIDTH + i / WIDTH) % 2 == 1);
        odd.for_each(|i| rgb.pixels_mut()[i] = GREEN);
        let frame = ViewFrame { gray: rgb.to_gray(), depth: Image::filled(WIDTH, HEIGHT, 2.0) };
        let edge = |seen: Option<bool>| {
            let found = Colours::default().assign(&view(), (&rgb, &frame), &[seen; WIDTH * HEIGHT], &given).to_vec();
            edges(&found)[HEIGHT / 2]
        };
        assert_eq!([None, Some(true), Some(false)].map(edge), [EDGE, EDGE - 3, EDGE + 3]);
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
    fn nothing_is_decided_without_a_sample_of_both_sides() {
        let all = labels(|_, _| true);
        assert!(assigned(|u, _| u >= EDGE, [RED, GREEN], &all) == all, "no surroundings");
        let none = labels(|_, _| false);
        assert!(assigned(|u, _| u >= EDGE, [RED, GREEN], &none) == none, "no movers");
        let thin = labels(|u, _| u == EDGE);
        assert!(assigned(|u, _| u >= EDGE, [RED, GREEN], &thin) == thin, "no pixel of it is out of question");
    }

    #[test]
    fn a_histogram_keeps_its_sum_and_leaks_to_neighbours_alone() {
        let mut histogram = Histogram::default();
        histogram.clear();
        let (middle, corner) = (bin([128, 128, 128]), bin([0, 0, 0]));
        (0..8).for_each(|_| histogram.add(middle));
        (0..2).for_each(|_| histogram.add(corner));
        histogram.smooth();
        assert!((histogram.counts.iter().sum::<f32>() - 10.0).abs() < 1e-4);
        let kept = (1.0 - 2.0 * LEAKAGE).powi(3);
        assert!((histogram.counts[middle as usize] - 8.0 * kept).abs() < 1e-4);
        let beside = histogram.counts[middle as usize + 1];
        assert!((beside - 8.0 * LEAKAGE * (1.0 - 2.0 * LEAKAGE).powi(2)).abs() < 1e-4);
        assert_eq!(histogram.counts[middle as usize + 2], 0.0);
        assert!((0..4096).all(|b| histogram.share(b) > 0.0));
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

    #[test]
    fn histograms_are_as_far_apart_as_they_differ() {
        let of = |colours: &[([u8; 3], usize)]| {
            let mut histogram = Histogram::default();
            histogram.clear();
            colours.iter().for_each(|&(c, times)| (0..times).for_each(|_| histogram.add(bin(c))));
            histogram
        };
        let red = of(&[(RED, 5)]);
        assert_eq!([of(&[(RED, 80)]), of(&[(GREEN, 7)])].map(|h| red.distance(&h)), [0.0, 1.0]);
        assert!((red.distance(&of(&[(RED, 30), (GREEN, 10)])) - 0.25).abs() < 1e-6);
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
