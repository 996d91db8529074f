//! No images are allocated per frame but the mask that is handed out. (What OpenCV allocates in C++ is not seen here.)

#![allow(unsafe_code)] // an allocator can be written in no other way
#![allow(clippy::unwrap_used)] // a test that cannot set up its scene fails

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use pfd_geometry::{Camera, DepthImage, Distortion, Image, RgbdFrame, Stamp};
use pfd_segmentation::{Mode, SegmentationConfig, Segmenter};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Bytes of images of one and of four bytes per pixel, at full and at half resolution.
const IMAGES: [usize; 3] = [WIDTH * HEIGHT / 4, WIDTH * HEIGHT, 4 * WIDTH * HEIGHT];
/// Frames until all buffers have their size: the history of mode `pfd` is full by then.
const WARM_UP: usize = 20;

/// The system's allocator, which counts what has the size of an image.
struct Counting;

static ALLOCATED: AtomicUsize = AtomicUsize::new(0);

fn count(bytes: usize) {
    if IMAGES.contains(&bytes) {
        ALLOCATED.fetch_add(1, Ordering::Relaxed);
    }
}

// SAFETY: everything is passed on to the system's allocator as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller's promises are those that `System` asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size);
        // SAFETY: as above.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A patterned wall and before it a patterned box, which moves to the right.
fn scene(frame: usize) -> RgbdFrame {
    let cell = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 251) as u8;
    let left = 40 + 8 * frame;
    let on_box = |u: usize, v: usize| (left..left + 140).contains(&u) && (160..380).contains(&v);
    let mut rgb = Image::filled(WIDTH, HEIGHT, [0_u8; 3]);
    let mut depth = Image::filled(WIDTH, HEIGHT, 3.0_f32);
    for v in 0..HEIGHT {
        for u in 0..WIDTH {
            let inside = on_box(u, v);
            rgb[(u, v)] = [if inside { cell((u - left) / 12, v / 12) } else { cell(u / 10 + 50, v / 10) }; 3];
            if inside {
                depth[(u, v)] = 1.5;
            }
        }
    }
    let stamp = Stamp::from_secs_f64(1000.0 + frame as f64 / 30.0).unwrap();
    RgbdFrame::new(stamp, rgb, DepthImage::from_metres(depth)).unwrap()
}

#[test]
fn a_frame_allocates_no_image_but_its_mask() {
    let camera = Camera::new((WIDTH, HEIGHT), [525.0, 525.0, 319.5, 239.5], Distortion::default()).unwrap();
    for mode in [Mode::Pfd, Mode::Paper] {
        let mut segmenter = Segmenter::new(camera, mode, &SegmentationConfig::default(), 0).unwrap();
        for frame in 0..WARM_UP + 5 {
            let image = scene(frame);
            ALLOCATED.store(0, Ordering::Relaxed);
            let result = segmenter.segment(&image).unwrap();
            let allocated = ALLOCATED.load(Ordering::Relaxed);
            if frame >= WARM_UP {
                assert!(result.mask.fraction() > 0.01, "mode {mode}, frame {frame}: nothing was found to move");
                assert_eq!(allocated, 1, "mode {mode}, frame {frame}");
            }
        }
    }
}
