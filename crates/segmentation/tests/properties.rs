//! Properties of segmentation on small rendered scenes: a textured wall and a box in front of it.

#![allow(clippy::unwrap_used)] // helpers of tests may panic: that is how tests fail

use pfd_geometry::{Camera, DepthImage, Distortion, Image, RgbdFrame, Stamp};
use pfd_segmentation::{
    Compensation, FailOpenReason, MissingDepth, Mode, PfdConfig, RegionShape, Segmentation, SegmentationConfig,
    SegmentationError, Segmenter, Status,
};
use proptest::prelude::*;

const WIDTH: usize = 320;
const HEIGHT: usize = 240;
/// Depth of the wall and of the box, metres.
const WALL: f32 = 3.0;
const BOX: f32 = 1.5;

fn camera(width: usize, height: usize) -> Camera {
    let focal = 0.82 * width.max(2) as f64;
    let center = [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0];
    Camera::new((width, height), [focal, focal, center[0], center[1]], Distortion::default()).unwrap()
}

fn stamp(frame: usize) -> Stamp {
    Stamp::from_secs_f64(1000.0 + frame as f64 / 30.0).unwrap()
}

/// A value in 0..=255 that looks random but depends on the cell only.
fn noise(x: usize, y: usize, salt: u32) -> u8 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77) ^ salt;
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    (h >> 24) as u8
}

/// The wall, and the box with its left top corner at `(x, 80)` if there is one.
fn scene(frame: usize, x: Option<usize>) -> RgbdFrame {
    let mut rgb = Image::filled(WIDTH, HEIGHT, [0_u8; 3]);
    let mut depth = Image::filled(WIDTH, HEIGHT, WALL);
    for v in 0..HEIGHT {
        for u in 0..WIDTH {
            let inside = x.is_some_and(|x| (x..x + 70).contains(&u) && (80..190).contains(&v));
            let value = if inside { noise((u - x.unwrap_or(0)) / 6, v / 6, 7) } else { noise(u / 5, v / 5, 1) };
            rgb[(u, v)] = [value; 3];
            if inside {
                depth[(u, v)] = BOX;
            }
        }
    }
    RgbdFrame::new(stamp(frame), rgb, DepthImage::from_metres(depth)).unwrap()
}

fn segmenter(mode: Mode) -> Segmenter {
    Segmenter::new(camera(WIDTH, HEIGHT), mode, &SegmentationConfig::default(), 1).unwrap()
}

/// Recall and precision of a mask for the box at `x`.
fn score(result: &Segmentation, x: usize) -> (f64, f64) {
    let (mut hit, mut marked) = (0.0, 0.0);
    for v in 0..HEIGHT {
        for u in 0..WIDTH {
            if result.mask.is_dynamic(u, v) {
                marked += 1.0;
                hit += f64::from(u8::from((x..x + 70).contains(&u) && (80..190).contains(&v)));
            }
        }
    }
    (hit / (70.0 * 110.0), hit / f64::max(marked, 1.0))
}

#[test]
fn a_box_that_comes_in_is_masked_within_three_frames_and_nothing_else_is() {
    let mut segmenter = segmenter(Mode::Pfd);
    for frame in 0..10 {
        let result = segmenter.segment(&scene(frame, None)).unwrap();
        assert_eq!(result.mask.fraction(), 0.0, "frame {frame} of a static scene");
    }
    for step in 0..10 {
        let x = 20 + 8 * step;
        let result = segmenter.segment(&scene(10 + step, Some(x))).unwrap();
        let (recall, precision) = score(&result, x);
        assert!(step < 3 || (recall > 0.9 && precision > 0.9), "step {step}: recall {recall}, precision {precision}");
        if step == 9 {
            let region = &result.regions[0];
            assert_eq!(result.regions.len(), 1);
            assert!((region.depth_interval[0] - BOX).abs() < 0.05 && (region.depth_interval[1] - BOX).abs() < 0.05);
            assert!(region.bounding_box.x.abs_diff(x as u32) < 6 && region.bounding_box.width.abs_diff(70) < 10);
            assert!((region.image_velocity.x - 240.0).abs() < 40.0, "{}", region.image_velocity);
        }
    }
}

/// The frame in another light.
fn lit(frame: &RgbdFrame, light: f32) -> RgbdFrame {
    let mut rgb = frame.rgb().clone();
    rgb.pixels_mut().iter_mut().flatten().for_each(|value| *value = (f32::from(*value) * light) as u8);
    RgbdFrame::new(frame.stamp(), rgb, frame.depth().clone()).unwrap()
}

#[test]
fn a_lamp_that_goes_off_hides_no_mover_and_makes_none() {
    for light in [0.4, 0.7] {
        let mut segmenter = segmenter(Mode::Pfd);
        for frame in 0..18 {
            let x = (frame >= 6).then(|| 20 + 6 * (frame - 6));
            let seen = lit(&scene(frame, x), if frame < 12 { 1.0 } else { light });
            let result = segmenter.segment(&seen).unwrap();
            if frame >= 10 {
                assert_eq!(result.status, Status::Segmented, "frame {frame} at {light}");
                let (recall, precision) = score(&result, x.unwrap());
                assert!(recall > 0.85 && precision > 0.85, "frame {frame} at {light}: {recall} {precision}");
            }
        }
    }
}

#[test]
fn a_box_that_leaves_is_masked_to_the_last_column() {
    let mut segmenter = segmenter(Mode::Pfd);
    let box_at = |frame: usize| WIDTH + 2 * frame - 79;
    for frame in 0..40 {
        let result = segmenter.segment(&scene(frame, (frame >= 5).then(|| box_at(frame)))).unwrap();
        // A single column has fewer pixels than a new region needs.
        if box_at(frame) == WIDTH - 1 {
            assert!(result.mask.fraction() > 0.0);
            return;
        }
    }
    panic!("the box never left");
}

#[test]
fn two_frames_suffice_for_a_box_that_moves() {
    let mut segmenter = segmenter(Mode::Pfd);
    segmenter.segment(&scene(0, Some(120))).unwrap();
    let (recall, precision) = score(&segmenter.segment(&scene(1, Some(126))).unwrap(), 126);
    assert!(recall > 0.8 && precision > 0.8, "recall {recall}, precision {precision}");
}

#[test]
fn a_box_that_is_put_down_becomes_part_of_the_scene() {
    let mut segmenter = segmenter(Mode::Pfd);
    for frame in 0..10 {
        segmenter.segment(&scene(frame, None)).unwrap();
    }
    for step in 0..15 {
        segmenter.segment(&scene(10 + step, Some(20 + 8 * step))).unwrap();
    }
    let rest = SegmentationConfig::default().pfd.rest_time;
    let (mut paused, mut rested) = (0.0, 1.0);
    for frame in 25..25 + (rest * 45.0) as usize {
        let fraction = segmenter.segment(&scene(frame, Some(132))).unwrap().mask.fraction();
        if frame == 30 {
            paused = fraction;
        }
        rested = fraction;
    }
    assert!(paused > 0.08, "a pause of a sixth of a second: {paused}");
    assert_eq!(rested, 0.0);
}

#[test]
fn every_mode_starts_with_an_empty_mask_and_keeps_the_size() {
    for mode in Mode::ALL {
        let mut segmenter = segmenter(mode);
        for frame in 0..4 {
            let result = segmenter.segment(&scene(frame, Some(20 + 8 * frame))).unwrap();
            assert_eq!(result.mask.image().size(), (WIDTH, HEIGHT));
            assert_eq!(result.regions.len(), result.particles.len());
            if frame == 0 {
                assert_eq!(result.mask.fraction(), 0.0);
                assert!(mode == Mode::None || result.status == Status::FirstFrame);
            }
        }
    }
}

#[test]
fn a_frame_of_another_size_is_refused_and_the_next_is_not() {
    let mut segmenter = segmenter(Mode::Pfd);
    let small =
        RgbdFrame::new(stamp(0), Image::filled(32, 24, [9_u8; 3]), DepthImage::from_metres(Image::filled(32, 24, 1.0)));
    assert!(matches!(segmenter.segment(&small.unwrap()), Err(SegmentationError::Frame(_))));
    assert!(segmenter.segment(&scene(1, None)).is_ok());
}

#[test]
fn the_same_seed_gives_the_same_result() {
    for mode in [Mode::Pfd, Mode::Paper] {
        let run = || {
            let mut segmenter = segmenter(mode);
            (0..8)
                .map(|frame| {
                    let result = segmenter.segment(&scene(frame, Some(20 + 8 * frame))).unwrap();
                    (result.mask, result.regions, result.particles)
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(run(), run(), "{mode}");
    }
}

#[test]
fn reset_is_a_new_start() {
    let mut used = segmenter(Mode::Pfd);
    for frame in 0..5 {
        used.segment(&scene(frame, Some(20 + 8 * frame))).unwrap();
    }
    used.reset();
    let mut fresh = segmenter(Mode::Pfd);
    for frame in 0..5 {
        let input = scene(frame, Some(40 + 8 * frame));
        let (a, b) = (used.segment(&input).unwrap(), fresh.segment(&input).unwrap());
        assert_eq!((a.mask, a.regions), (b.mask, b.regions));
    }
}

#[test]
fn a_frame_older_than_the_last_begins_anew() {
    for mode in [Mode::Pfd, Mode::Paper] {
        let mut segmenter = segmenter(mode);
        let mut status = |frame| segmenter.segment(&scene(frame, None)).unwrap().status;
        assert_eq!([5, 6, 7].map(&mut status)[0], Status::FirstFrame);
        assert_eq!([2, 3].map(status), [Status::FirstFrame, Status::Segmented], "{mode}");
    }
}

/// The frame as a camera shows it that has turned: what was seen lies `shift` pixels farther left.
fn turned(frame: &RgbdFrame, shift: usize) -> RgbdFrame {
    let mut rgb = Image::filled(WIDTH, HEIGHT, [0_u8; 3]);
    for v in 0..HEIGHT {
        for u in 0..WIDTH {
            rgb[(u, v)] = match u + shift {
                seen if seen < WIDTH => frame.rgb()[(seen, v)],
                new => [noise(new / 5, v / 5, 1); 3],
            };
        }
    }
    RgbdFrame::new(frame.stamp(), rgb, frame.depth().clone()).unwrap()
}

#[test]
fn a_jerk_of_the_camera_costs_no_frame() {
    let mut segmenter = segmenter(Mode::Pfd);
    for frame in 0..12 {
        let seen = turned(&scene(frame, None), if frame < 6 { 0 } else { 90 });
        let result = segmenter.segment(&seen).unwrap();
        let expected = if frame == 0 { Status::FirstFrame } else { Status::Segmented };
        assert_eq!(result.status, expected, "frame {frame}");
        assert!(result.mask.fraction() < 0.01, "frame {frame}: {}", result.mask.fraction());
    }
}

/// A plain wall with four small spots: few corners tell how the camera moves. With the spots elsewhere, `others`, nothing does.
fn plain_wall(frame: usize, others: bool) -> RgbdFrame {
    let textured = scene(frame, None);
    let mut rgb = textured.rgb().clone();
    let shift = if others { 20 } else { 0 };
    for v in 0..HEIGHT {
        for u in 0..WIDTH {
            let on_spot = (53..58).contains(&((u + shift) % 192)) && (37..42).contains(&((v + shift) % 160));
            if !on_spot {
                rgb[(u, v)] = [120; 3];
            }
        }
    }
    RgbdFrame::new(textured.stamp(), rgb, textured.depth().clone()).unwrap()
}

#[test]
fn few_corners_suffice_where_the_surfaces_agree() {
    let mut segmenter = segmenter(Mode::Pfd);
    let statuses: Vec<Status> = (0..6).map(|f| segmenter.segment(&plain_wall(f, false)).unwrap().status).collect();
    assert!(statuses[1..].iter().all(|s| *s == Status::Segmented), "{statuses:?}");
    let elsewhere = segmenter.segment(&plain_wall(6, true)).unwrap();
    assert!(matches!(elsewhere.status, Status::FailedOpen(FailOpenReason::FewInliers { .. })), "{elsewhere:?}");
}

#[test]
fn after_a_cut_to_another_room_the_new_one_is_learned_within_a_fifth_of_a_second() {
    let mut segmenter = segmenter(Mode::Pfd);
    let mirrored = |frame: usize| {
        let mut rgb = scene(frame, None).rgb().clone();
        rgb.pixels_mut().reverse();
        RgbdFrame::new(stamp(frame), rgb, scene(frame, None).depth().clone()).unwrap()
    };
    (0..6).for_each(|frame| drop(segmenter.segment(&scene(frame, None)).unwrap()));
    let after: Vec<Segmentation> = (6..14).map(|frame| segmenter.segment(&mirrored(frame)).unwrap()).collect();
    let failed = |r: &Segmentation| matches!(r.status, Status::FailedOpen(FailOpenReason::FewInliers { .. }));
    let refused = after.iter().take_while(|r| failed(r)).count();
    assert!((5..8).contains(&refused), "{refused} frames");
    assert!(after.iter().all(|r| r.mask.fraction() == 0.0));
}

/// What a covered lens shows.
fn darkness(frame: usize) -> RgbdFrame {
    let depth = DepthImage::from_metres(Image::filled(WIDTH, HEIGHT, 0.0));
    RgbdFrame::new(stamp(frame), Image::filled(WIDTH, HEIGHT, [3; 3]), depth).unwrap()
}

#[test]
fn nothing_is_compared_with_a_covered_lens() {
    let mut segmenter = segmenter(Mode::Pfd);
    segmenter.segment(&scene(0, None)).unwrap();
    for frame in 1..12 {
        let result = segmenter.segment(&darkness(frame)).unwrap();
        assert!(matches!(result.status, Status::FailedOpen(_)) && result.mask.fraction() == 0.0, "frame {frame}");
    }
    let mut status = |frame| segmenter.segment(&scene(frame, None)).unwrap().status;
    assert_eq!([12, 13].map(&mut status), [Status::FirstFrame, Status::Segmented]);
}

#[test]
fn a_mask_that_is_not_believed_leaves_nothing_behind() {
    let mut config = SegmentationConfig::default();
    config.pfd.max_mask_share = 0.08;
    let mut segmenter = Segmenter::new(camera(WIDTH, HEIGHT), Mode::Pfd, &config, 1).unwrap();
    (0..10).for_each(|frame| drop(segmenter.segment(&scene(frame, None)).unwrap()));
    let came_in: Vec<Segmentation> =
        (10..14).map(|frame| segmenter.segment(&scene(frame, Some(8 * frame))).unwrap()).collect();
    let refused = |r: &Segmentation| matches!(r.status, Status::FailedOpen(FailOpenReason::MaskTooLarge { .. }));
    assert!(came_in.iter().any(refused), "the box covers a tenth of the image");
    assert!(came_in.iter().filter(|r| refused(r)).all(|r| r.mask.fraction() == 0.0 && r.regions.is_empty()));
    let after = segmenter.segment(&scene(14, None)).unwrap();
    assert_eq!((after.status, after.mask.fraction()), (Status::Segmented, 0.0));
}

#[test]
fn the_published_modes_mask_what_moves() {
    // The discs around the features of `flow` leave gaps, and reach beyond the outline.
    for (mode, least_recall, least_precision) in
        [(Mode::Paper, 0.6, 0.6), (Mode::Single, 0.6, 0.6), (Mode::Flow, 0.4, 0.5)]
    {
        let (recall, precision) = mean_score(segmenter(mode));
        assert!(recall > least_recall && precision > least_precision, "{mode}: {recall} and {precision}");
    }
}

/// Mean recall and precision of a box that moves by six pixels a frame, once it has been seen for a while.
fn mean_score(mut segmenter: Segmenter) -> (f64, f64) {
    const SETTLED: usize = 10;
    const FRAMES: usize = 25;
    let scores = (0..FRAMES).map(|frame| {
        let x = 20 + 6 * frame;
        score(&segmenter.segment(&scene(frame, Some(x))).unwrap(), x)
    });
    let settled = scores.skip(SETTLED).fold((0.0, 0.0), |sum, (r, p)| (sum.0 + r, sum.1 + p));
    let count = (FRAMES - SETTLED) as f64;
    (settled.0 / count, settled.1 / count)
}

#[test]
fn with_any_one_switch_off_a_box_that_moves_is_still_masked() {
    let switches: [fn(&mut PfdConfig); 14] = [
        |c| c.compensation = Compensation::Homography,
        |c| c.missing_depth = MissingDepth::Homography,
        |c| c.older_reference = false,
        |c| c.static_model = false,
        |c| c.anchored_motion = false,
        |c| c.region = RegionShape::Rectangle,
        |c| c.whole_things = false,
        |c| c.rigid_planes = false,
        |c| c.moving_corners = false,
        |c| c.refined_outlines = false,
        |c| c.temporal = false,
        |c| c.shadow_rejection = false,
        |c| c.particle_support = false,
        |c| c.fail_open = false,
    ];
    for (index, switch) in switches.into_iter().enumerate() {
        let mut config = SegmentationConfig::default();
        switch(&mut config.pfd);
        let (recall, precision) = mean_score(Segmenter::new(camera(WIDTH, HEIGHT), Mode::Pfd, &config, 1).unwrap());
        assert!(recall > 0.8 && precision > 0.8, "{index}: {recall} and {precision}");
    }
}

#[test]
fn parameters_out_of_range_are_named() {
    let mut config = SegmentationConfig::default();
    config.particles.count = 0;
    let error = Segmenter::new(camera(64, 48), Mode::Pfd, &config, 0).unwrap_err();
    assert!(error.to_string().contains("particles.count"), "{error}");
    type Change = fn(&mut SegmentationConfig);
    let wrong: [(&str, Change); 3] = [
        ("paper.depth_clusters", |c| c.paper.depth_clusters = 0),
        ("pfd.threshold", |c| c.pfd.threshold = f64::NAN),
        ("pfd.max_mask_share", |c| c.pfd.max_mask_share = -0.1),
    ];
    for (name, change) in wrong {
        let mut config = SegmentationConfig::default();
        change(&mut config);
        let error = Segmenter::new(camera(64, 48), Mode::Pfd, &config, 0).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
    }
}

/// A frame whose depth is arbitrary: zeros, tiny, huge and ordinary values.
fn fuzzed(width: usize, height: usize) -> impl Strategy<Value = RgbdFrame> {
    let value = prop_oneof![Just(0.0_f32), Just(1e-6), Just(1e6), Just(f32::NAN), 0.3..6.0_f32];
    let depth = prop::collection::vec(value, width * height);
    let colour = prop::collection::vec(any::<[u8; 3]>(), width * height);
    (depth, colour).prop_map(move |(depth, colour)| {
        let depth = DepthImage::from_metres(Image::from_vec(width, height, depth).unwrap());
        RgbdFrame::new(stamp(0), Image::from_vec(width, height, colour).unwrap(), depth).unwrap()
    })
}

/// Frame `frame` of the scene with the box, its depth replaced in blocks by arbitrary values: its colours can be followed.
fn damaged(frame: usize) -> impl Strategy<Value = RgbdFrame> {
    let value = prop_oneof![Just(0.0_f32), Just(1e-6), Just(1e6), Just(f32::NAN), 0.3..6.0_f32];
    prop::collection::vec((0..WIDTH / 20, 0..HEIGHT / 20, value), 0..120).prop_map(move |blocks| {
        let whole = scene(frame, Some(20 + 8 * frame));
        let mut depth = whole.depth().image().clone();
        for (x, y, value) in blocks {
            (0..400).for_each(|k| depth[(20 * x + k % 20, 20 * y + k / 20)] = value);
        }
        RgbdFrame::new(stamp(frame), whole.rgb().clone(), DepthImage::from_metres(depth)).unwrap()
    })
}

fn is_finite(result: &Segmentation) -> bool {
    result.regions.iter().all(|region| {
        let state = region.particle_mean.iter().chain(&region.particle_covariance).chain(&region.image_velocity);
        state.copied().all(f64::is_finite) && region.depth_interval.iter().all(|x| x.is_finite())
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn any_depth_of_frames_that_can_be_followed(
        frames in (damaged(0), damaged(1), damaged(2), damaged(3), damaged(4)),
        mode in prop::sample::select(&Mode::ALL[..]),
    ) {
        let mut segmenter = segmenter(mode);
        for frame in [frames.0, frames.1, frames.2, frames.3, frames.4] {
            let result = segmenter.segment(&frame).unwrap();
            prop_assert_eq!(result.mask.image().size(), (WIDTH, HEIGHT));
            prop_assert!(is_finite(&result));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_size_and_any_depth(
        frames in (1..90_usize, 1..70_usize).prop_flat_map(|(w, h)| prop::collection::vec(fuzzed(w, h), 3)),
        mode in prop::sample::select(&Mode::ALL[..]),
    ) {
        let (width, height) = frames[0].rgb().size();
        let mut segmenter = Segmenter::new(camera(width, height), mode, &SegmentationConfig::default(), 3).unwrap();
        for frame in &frames {
            let result = segmenter.segment(frame).unwrap();
            prop_assert_eq!(result.mask.image().size(), (width, height));
            prop_assert!(is_finite(&result));
        }
    }
}
