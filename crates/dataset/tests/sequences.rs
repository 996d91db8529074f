//! Sequences written to disk and read back.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
// Numbers that are read must be exactly those that were written.
#![allow(clippy::float_cmp)]

use std::fmt::Write as _;
use std::path::Path;

use image::{ImageBuffer, Luma, Rgb};
use pfd_dataset::{DatasetError, Options, Pairing, Sequence};

const CALIBRATION: &str = "fx: 500\nfy: 500\ncx: 2\ncy: 1\ndepth_factor: 1000\n";

fn write_image(folder: &Path, name: &str, value: u16) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    if name.starts_with("rgb") {
        ImageBuffer::from_pixel(4, 2, Rgb([value as u8, 20, 30])).save(path).unwrap();
    } else {
        ImageBuffer::from_pixel(4, 2, Luma([value])).save(path).unwrap();
    }
}

/// Three colour and three depth images, 40 ms apart, depth 5 ms late.
fn write_sequence(folder: &Path) {
    let (mut rgb, mut depth) = (String::from("# color images\n"), String::from("# depth maps\n"));
    for i in 0..3_u16 {
        let (a, b) = (format!("rgb/{i}.png"), format!("depth/{i}.png"));
        write_image(folder, &a, i * 10);
        write_image(folder, &b, 1500 + i);
        writeln!(rgb, "1.{:03} {a}", 40 * i).unwrap();
        writeln!(depth, "1.{:03} {b}", 40 * i + 5).unwrap();
    }
    std::fs::write(folder.join("rgb.txt"), rgb).unwrap();
    std::fs::write(folder.join("depth.txt"), depth).unwrap();
    std::fs::write(folder.join("calib.yaml"), CALIBRATION).unwrap();
}

fn error_of(folder: &Path) -> String {
    Sequence::open(folder).map(|_| ()).unwrap_err().to_string()
}

#[test]
fn reads_frames_camera_and_name() {
    let folder = tempfile::tempdir().unwrap();
    write_sequence(folder.path());
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!((sequence.len(), sequence.unpaired()), (3, 0));
    assert_eq!(sequence.name(), folder.path().file_name().unwrap().to_str().unwrap());
    let camera = sequence.camera().unwrap();
    assert_eq!((camera.width, camera.height, camera.fx), (4, 2, 500.0));
    let frame = sequence.frame(1).unwrap();
    assert_eq!(frame.stamp().to_string(), "1.040000");
    assert_eq!(frame.rgb()[(0, 0)], [10, 20, 30]);
    assert_eq!(frame.depth().at(3, 1), Some(1.501));
    assert!(sequence.ground_truth().is_none());
    assert!(matches!(sequence.frame(3), Err(DatasetError::OutOfRange { index: 3, len: 3 })));
}

#[test]
fn an_archive_gives_the_same_frames() {
    let folder = tempfile::tempdir().unwrap();
    write_sequence(folder.path());
    let archive = folder.path().join("rgbd_dataset_freiburg3_test.tgz");
    let file = std::fs::File::create(&archive).unwrap();
    let mut builder = tar::Builder::new(flate2::write::GzEncoder::new(file, flate2::Compression::fast()));
    for name in ["rgb", "depth"] {
        builder.append_dir_all(format!("rgbd_dataset_freiburg3_test/{name}"), folder.path().join(name)).unwrap();
    }
    for name in ["rgb.txt", "depth.txt"] {
        builder.append_path_with_name(folder.path().join(name), format!("rgbd_dataset_freiburg3_test/{name}")).unwrap();
    }
    builder.into_inner().unwrap().finish().unwrap();
    let (packed, plain) = (Sequence::open(&archive).unwrap(), Sequence::open(folder.path()).unwrap());
    assert_eq!(packed.name(), "rgbd_dataset_freiburg3_test");
    assert_eq!(packed.camera().unwrap().fx, 535.4);
    assert_eq!(packed.frame(2).unwrap().rgb(), plain.frame(2).unwrap().rgb());
    let unpacked = packed.folder().to_owned();
    drop(packed);
    assert!(!unpacked.exists());
}

#[test]
fn a_broken_image_spares_the_others() {
    let folder = tempfile::tempdir().unwrap();
    write_sequence(folder.path());
    std::fs::write(folder.path().join("rgb/1.png"), b"broken").unwrap();
    let sequence = Sequence::open(folder.path()).unwrap();
    let frames: Vec<_> = sequence.frames().collect();
    assert!(frames[0].is_ok() && frames[2].is_ok());
    let error = frames[1].as_ref().unwrap_err();
    assert!(error.concerns_one_frame() && error.to_string().contains("rgb/1.png"), "{error}");
}

#[test]
fn errors_name_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    assert!(error_of(folder.path()).contains("not a sequence"));
    assert!(error_of(&folder.path().join("missing")).contains("missing"));
    write_sequence(folder.path());
    let put = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    put("groundtruth.txt", "# x\n1.0 0 0 0 0 0 0 1\n1.1 0 0 zero 0 0 0 1\n");
    assert!(error_of(folder.path()).contains("groundtruth.txt:3: tz `zero`"));
    put("groundtruth.txt", "");
    put("calib.yaml", "fx: 1\n");
    assert!(error_of(folder.path()).contains("calib.yaml"));
    put("depth.txt", "9.0 depth/0.png\n8.0 depth/1.png\n");
    assert!(error_of(folder.path()).contains("depth.txt:2: stamp 8.000000 is not later"));
    put("depth.txt", "9.0 depth/0.png\n");
    assert!(error_of(folder.path()).contains("same clock"));
    std::fs::remove_file(folder.path().join("depth.txt")).unwrap();
    assert!(error_of(folder.path()).contains("depth.txt"));
}

#[test]
fn offset_and_pairing_decide_the_depth_image() {
    let folder = tempfile::tempdir().unwrap();
    write_sequence(folder.path());
    let open = |options: Options| Sequence::open_with(folder.path(), &options).unwrap();
    let shifted = open(Options { depth_offset: -0.040, ..Options::default() });
    assert_eq!((shifted.len(), shifted.unpaired()), (2, 1));
    assert_eq!(shifted.pair(0).depth_stamp.to_string(), "1.045000");
    std::fs::write(folder.path().join("depth.txt"), "1.020 depth/0.png\n").unwrap();
    assert_eq!(open(Options::default()).len(), 2);
    assert_eq!(open(Options { pairing: Pairing::OneToOne, ..Options::default() }).len(), 1);
}

#[test]
fn colour_and_depth_must_have_one_size() {
    let folder = tempfile::tempdir().unwrap();
    write_sequence(folder.path());
    ImageBuffer::from_pixel(2, 2, Luma([1_u16])).save(folder.path().join("depth/0.png")).unwrap();
    let error = Sequence::open(folder.path()).unwrap().frame(0).unwrap_err();
    assert!(error.concerns_one_frame() && error.to_string().contains("registered"), "{error}");
}
