//! A camera that turns round once in a room, with a focal length that is off: only recognising the place where it began can tell
//! by how much.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Point2, Vector3, Vector6};
use pfd_geometry::{Camera, DepthImage, Distortion, Image, Mask, Pose, RgbdFrame, Stamp, pose};
use pfd_tracking::{Tracker, TrackingConfig, TrackingState};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const FOCAL: f64 = 500.0;
/// What the tracker is told, as a share of the true focal length: so wrong that the place where the turn began is not met by itself.
const CALIBRATION: f64 = 0.9;
/// Frames of a full turn, of what follows in view of the place where it began, and of the way back to just this place: elsewhere in view of
/// it the wrong focal length alone makes an error of some degrees.
const TURN: usize = 150;
const AFTER: usize = 20;
const BACK: usize = 20;
/// Half the sides of the room, metres.
const ROOM: [f64; 3] = [2.0, 1.4, 2.6];
/// Side of the tiles of its walls, metres.
const TILE: f64 = 0.12;

fn camera(factor: f64) -> Camera {
    Camera::new((WIDTH, HEIGHT), [FOCAL * factor, FOCAL * factor, 319.5, 239.5], Distortion::default()).unwrap()
}

/// Camera to world in frame `i`: it turns about the vertical on a small circle, and back at last.
#[allow(non_snake_case)]
fn T_world_camera(i: usize) -> Pose {
    let steps = i.min(2 * (TURN + AFTER) - i);
    let angle = std::f64::consts::TAU * steps as f64 / TURN as f64;
    pose::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, angle, 0.0)) * pose::exp(&Vector6::new(0.0, 0.0, 0.3, 0.0, 0.0, 0.0))
}

/// Distance along a ray from inside the room to its walls, and their brightness there: tiles of any grey.
fn look(origin: &Vector3<f64>, direction: &Vector3<f64>) -> (f64, u8) {
    let to_wall = |axis: usize| (ROOM[axis].copysign(direction[axis]) - origin[axis]) / direction[axis];
    let wall = (0..3).min_by(|a, b| to_wall(*a).total_cmp(&to_wall(*b))).unwrap();
    let distance = to_wall(wall);
    let hit = origin + direction * distance;
    let tile = |axis: usize| (hit[axis] / TILE).floor() as i64;
    let side = i64::from(direction[wall] > 0.0) + 2 * wall as i64;
    let number = (0..3).filter(|axis| *axis != wall).fold(side, |n, axis| n * 7919 + tile(axis));
    // Multiplicative hashing (Knuth).
    let gray = (number as u32).wrapping_mul(2_654_435_761) >> 24;
    (distance, gray as u8)
}

fn frame(i: usize) -> RgbdFrame {
    let (camera, pose) = (camera(1.0), T_world_camera(i));
    let mut rgb = Image::filled(camera.width, camera.height, [0_u8; 3]);
    let mut depth = Image::filled(camera.width, camera.height, 0.0_f32);
    for v in 0..camera.height {
        for u in 0..camera.width {
            let ray = camera.unproject(&Point2::new(u as f64, v as f64), 1.0).coords;
            let (z, gray) = look(&pose.translation.vector, &(pose.rotation * ray));
            rgb[(u, v)] = [gray; 3];
            depth[(u, v)] = z as f32;
        }
    }
    RgbdFrame::new(Stamp::default().offset_by(i as f64 / 30.0), rgb, DepthImage::from_metres(depth)).unwrap()
}

/// How far the camera seems turned beside where it is in the last frame, degrees, and how many loops were closed.
fn error_after_a_turn(loop_closing: bool) -> (f64, usize) {
    let mut config = TrackingConfig::default();
    config.places.loop_closing = loop_closing;
    let mut tracker = Tracker::new(camera(CALIBRATION), &config, 0).unwrap();
    let still = Mask::empty(WIDTH, HEIGHT);
    let mut last = Pose::identity();
    for i in 0..=TURN + AFTER + BACK {
        let tracked = tracker.track(&frame(i), Some(&still)).unwrap();
        assert_eq!(tracked.state, TrackingState::Ok, "frame {i}");
        last = tracked.T_world_camera.unwrap();
        tracker.map().check().unwrap();
    }
    let truth = T_world_camera(0).inverse() * T_world_camera(TURN + AFTER + BACK);
    ((truth.inverse() * last).rotation.angle().to_degrees(), tracker.loops())
}

#[test]
fn a_closed_loop_takes_the_drift_out_of_the_map() {
    let (open, none) = error_after_a_turn(false);
    assert_eq!(none, 0);
    assert!(open > 3.0, "a wrong focal length makes a full turn longer or shorter: {open}°");
    let (closed, loops) = error_after_a_turn(true);
    assert!(loops >= 1, "the place where the camera began was not recognised");
    assert!(closed < 0.3 * open, "{closed}° with a closed loop, {open}° without");
}
