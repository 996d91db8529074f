//! The command line as a user calls it.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use pfd_tests::{bundled_sequence, programs, repository};
use serde_json::Value;

/// Enough frames for a map, few enough for a test.
const FRAMES: &str = "12";

fn pfd_slam(arguments: &[&str]) -> Output {
    programs::pfd_slam().unwrap().args(arguments).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn run_bundled(out: &Path, more: &[&str]) -> Output {
    let sequence = bundled_sequence();
    let arguments = ["run", text(&sequence), "--out", text(out), "--max-frames", FRAMES];
    pfd_slam(&[&arguments[..], more].concat())
}

fn assert_success(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Exit status 1, one line on stderr, which names what is at fault.
fn assert_fails_naming(output: &Output, part: &str) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(stderr.contains(part), "{stderr}");
}

/// As [`assert_fails_naming`] for a run that had begun: its last line names what is at fault.
fn assert_stops_naming(output: &Output, part: &str) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.lines().last().is_some_and(|line| line.contains(part)), "{stderr}");
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn run_writes_the_documented_files() {
    let out = tempfile::tempdir().unwrap();
    let video = out.path().join("v.avi");
    assert_success(&run_bundled(out.path(), &["--save-masks", "--seed", "7", "--video", text(&video)]));
    let report = json(&out.path().join("report.json"));
    assert_eq!((report["frames"].as_u64(), report["seed"].as_u64()), (Some(12), Some(7)));
    assert_eq!(report["mode"], "pfd");
    for field in ["rmse", "mean", "median", "std", "min", "max", "pairs"] {
        assert!(report["ate"][field].is_number(), "ate.{field}");
    }
    for part in ["segmentation", "tracking", "total"] {
        assert!(report["timing_ms"][part]["p99"].as_f64().unwrap() > 0.0, "{part}");
    }
    assert!(report["config"]["segmentation"].is_object());
    assert_eq!(report["rpe_translation"], Value::Null, "the run is shorter than a second");
    let frames = std::fs::read_to_string(out.path().join("frames.csv")).unwrap();
    assert_eq!(frames.lines().count(), 13);
    assert!(
        frames.starts_with("stamp,state,segmentation_ms,tracking_ms,total_ms,features,inliers,mask_fraction,objects\n")
    );
    assert_eq!(std::fs::read_dir(out.path().join("masks")).unwrap().count(), 12);
    assert!(out.path().join("masks/1305031104.175424.png").exists());
    for file in ["trajectory.txt", "trajectory_live.txt", "keyframe_trajectory.txt", "picture.svg", "v.avi"] {
        assert!(out.path().join(file).metadata().unwrap().len() > 0, "{file}");
    }
    let page = std::fs::read_to_string(out.path().join("report.html")).unwrap();
    assert!(page.matches("<svg").count() >= 6 && page.contains("data:image/jpeg;base64"));
    assert!(!page.contains("src=\"http") && !page.contains("<script"));
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    for out in [&first, &second] {
        assert_success(&run_bundled(out.path(), &["--save-masks"]));
    }
    let names = |out: &Path| {
        let mut names: Vec<PathBuf> = std::fs::read_dir(out.join("masks"))
            .unwrap()
            .map(|e| Path::new("masks").join(e.unwrap().file_name()))
            .collect();
        names.sort();
        names
    };
    assert_eq!(names(first.path()), names(second.path()));
    let trajectories = ["trajectory.txt", "trajectory_live.txt", "keyframe_trajectory.txt"].map(PathBuf::from);
    for name in names(first.path()).iter().chain(&trajectories) {
        let bytes = |out: &Path| std::fs::read(out.join(name)).unwrap();
        assert!(bytes(first.path()) == bytes(second.path()), "{} differs", name.display());
    }
}

#[test]
fn every_mode_runs() {
    for mode in ["paper", "single", "flow", "none"] {
        let out = tempfile::tempdir().unwrap();
        assert_success(&run_bundled(out.path(), &["--mode", mode]));
        assert_eq!(json(&out.path().join("report.json"))["mode"], mode);
    }
}

#[test]
fn given_masks_replace_segmentation() {
    let out = tempfile::tempdir().unwrap();
    let truth = bundled_sequence().join("mask");
    assert_success(&run_bundled(out.path(), &["--masks", text(&truth), "--save-masks"]));
    let masks = out.path().join("masks");
    let judged = pfd_slam(&["eval-masks", text(&masks), text(&truth), "--json"]);
    let scores: Value = serde_json::from_slice(&judged.stdout).unwrap();
    assert_eq!((scores["frames"].as_u64(), scores["missing"].as_u64()), (Some(12), Some(130)));
    assert_eq!(scores["pixels"]["iou"], 1.0);
    assert_eq!(scores["static_masked"]["max"], 0.0);
    let missing = pfd_slam(&["eval-masks", text(out.path()), text(&truth)]);
    assert_fails_naming(&missing, "no PNG images");
}

#[test]
fn wrong_usage_is_status_2() {
    for arguments in [
        &["frobnicate"][..],
        &["run"],
        &["run", "x", "--out", "y", "--mode", "best"],
        &["run", "x", "--out", "y", "--max-frames", "0"],
        &["run", "x", "--out", "y", "--depth-offset", "nan"],
        &["eval", "x"],
    ] {
        assert_eq!(pfd_slam(arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn errors_name_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let missing = folder.path().join("no-such-sequence");
    assert_fails_naming(&pfd_slam(&["run", text(&missing), "--out", text(&out)]), "no-such-sequence");
    let config = folder.path().join("bad.yaml");
    std::fs::write(&config, "/**:\n  ros__parameters:\n    tracking:\n      no_such_key: 1\n").unwrap();
    let output = run_bundled(&out, &["--config", text(&config)]);
    assert_fails_naming(&output, "bad.yaml");
    assert_fails_naming(&output, "no_such_key");
    let truth = bundled_sequence().join("groundtruth.txt");
    let estimate = folder.path().join("estimate.txt");
    std::fs::write(&estimate, "1.0 0 0 0 0 0 0 1\n2.0 0 0 x 0 0 0 1\n").unwrap();
    assert_fails_naming(&pfd_slam(&["eval", text(&truth), text(&estimate)]), "estimate.txt:2: tz `x`");
    std::fs::write(&estimate, "1.0 0 0 0 0 0 0 1\n").unwrap();
    assert_fails_naming(&pfd_slam(&["eval", text(&truth), text(&estimate)]), "same recording");
}

/// Copies the first `count` frames of the bundled sequence.
fn copy_frames(target: &Path, count: usize) -> Vec<String> {
    let source = bundled_sequence();
    let mut colour = Vec::new();
    for (list, folder) in [("rgb.txt", "rgb"), ("depth.txt", "depth")] {
        std::fs::create_dir_all(target.join(folder)).unwrap();
        let lines = std::fs::read_to_string(source.join(list)).unwrap();
        let kept: Vec<&str> = lines.lines().filter(|l| !l.starts_with('#')).take(count).collect();
        for file in kept.iter().map(|l| l.split_whitespace().nth(1).unwrap()) {
            std::fs::copy(source.join(file), target.join(file)).unwrap();
            if folder == "rgb" {
                colour.push(file.to_owned());
            }
        }
        std::fs::write(target.join(list), kept.join("\n")).unwrap();
    }
    colour
}

#[test]
fn a_broken_image_is_skipped_and_a_missing_camera_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, out) = (folder.path().join("room"), folder.path().join("out"));
    let colour = copy_frames(&sequence, 6);
    assert_fails_naming(&pfd_slam(&["run", text(&sequence), "--out", text(&out)]), "the camera is not known");
    std::fs::copy(bundled_sequence().join("calib.yaml"), sequence.join("calib.yaml")).unwrap();
    std::fs::write(sequence.join(&colour[2]), b"broken").unwrap();
    let whole = std::fs::read(sequence.join(&colour[4])).unwrap();
    std::fs::write(sequence.join(&colour[4]), &whole[..whole.len() / 2]).unwrap();
    let output = pfd_slam(&["run", text(&sequence), "--out", text(&out)]);
    assert_success(&output);
    for broken in [&colour[2], &colour[4]] {
        assert!(String::from_utf8_lossy(&output.stderr).contains(broken), "{broken}");
    }
    let report = json(&out.join("report.json"));
    assert_eq!((report["skipped"].as_u64(), report["frames"].as_u64()), (Some(2), Some(4)));
    assert_eq!(report["ate"], Value::Null, "there is no ground truth");
}

#[test]
fn bench_makes_tables_and_goes_on_where_it_stopped() {
    let out = tempfile::tempdir().unwrap();
    let sequence = bundled_sequence();
    let bench = |more: &[&str]| {
        let modes = ["--modes", "none,given", "--runs", "2", "--max-frames", "4"];
        pfd_slam(&[&["bench", text(&sequence), "--out", text(out.path())][..], &modes, more].concat())
    };
    assert_success(&bench(&[]));
    let run = out.path().join("runs/composite-demo/none/1/report.json");
    let written = || run.metadata().unwrap().modified().unwrap();
    let before = written();
    assert_success(&bench(&[]));
    assert_eq!(written(), before, "a finished run was run again");
    assert_success(&bench(&["--one-to-one"]));
    assert_ne!(written(), before, "a run that read the sequence in another way was taken for this one");
    let nowhere = out.path().join("nowhere.md");
    std::fs::write(&nowhere, "no place").unwrap();
    assert_fails_naming(&bench(&["--into", text(&nowhere)]), "nowhere.md");
    let table = std::fs::read_to_string(out.path().join("bench.md")).unwrap();
    assert!(table.contains("| sequence | none | given |") && table.contains("| composite-demo |"), "{table}");
    assert!(table.contains("ORB-SLAM3"), "known sequences stand beside known figures");
    assert_eq!(std::fs::read_to_string(out.path().join("bench.csv")).unwrap().lines().count(), 5);
    assert_eq!(json(&out.path().join("bench.json")).as_array().unwrap().len(), 4);
    assert!(std::fs::read_to_string(out.path().join("bench.html")).unwrap().contains("What none takes to move"));
}

/// The bundled sequence's first frames, with camera and true masks.
fn copy_with_masks(target: &Path, count: usize) {
    let colour = copy_frames(target, count);
    std::fs::copy(bundled_sequence().join("calib.yaml"), target.join("calib.yaml")).unwrap();
    std::fs::create_dir_all(target.join("mask")).unwrap();
    for file in colour {
        let name = Path::new("mask").join(Path::new(&file).with_extension("png").file_name().unwrap());
        std::fs::copy(bundled_sequence().join(&name), target.join(&name)).unwrap();
    }
}

#[test]
fn masks_of_an_earlier_run_do_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, out, bench) = (folder.path().join("room"), folder.path().join("out"), folder.path().join("bench"));
    copy_with_masks(&sequence, 5);
    for frames in ["5", "3"] {
        let more = ["--max-frames", frames];
        assert_success(&pfd_slam(
            &[&["run", text(&sequence), "--out", text(&out), "--save-masks"][..], &more].concat(),
        ));
        let bench = ["bench", text(&sequence), "--out", text(&bench), "--modes", "none"];
        assert_success(&pfd_slam(&[&bench[..], &more].concat()));
    }
    let masks = out.join("masks");
    assert_eq!(std::fs::read_dir(&masks).unwrap().count(), 3);
    assert_eq!(json(&bench.join("bench.json"))[0]["masks"]["frames"], 3);
    let same = ["run", text(&sequence), "--out", text(&out), "--save-masks", "--masks", text(&masks)];
    assert_fails_naming(&pfd_slam(&same), "--masks reads");
    assert_eq!(std::fs::read_dir(&masks).unwrap().count(), 3);
}

/// Starts the program and waits until it says how far it is.
fn start(command: &mut Command) -> Child {
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    let mut first = [0];
    child.stderr.as_mut().unwrap().read_exact(&mut first).unwrap();
    child
}

#[test]
fn a_run_of_a_bench_that_was_killed_is_not_done() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, out) = (folder.path().join("room"), folder.path().join("out"));
    copy_with_masks(&sequence, 40);
    let bench = ["bench", text(&sequence), "--out", text(&out), "--modes", "none"];
    let run = out.join("runs/room/none/0");
    assert_success(&pfd_slam(&[&bench[..], &["--max-frames", "2"]].concat()));
    assert!(run.join("source.txt").exists());
    let mut child = start(programs::pfd_slam().unwrap().args(bench));
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!run.join("source.txt").exists() && !run.join("report.json").exists());
}

#[test]
fn a_bench_of_a_sequence_that_changed_is_made_anew() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, out) = (folder.path().join("room"), folder.path().join("out"));
    copy_with_masks(&sequence, 3);
    let bench = || {
        assert_success(&pfd_slam(&["bench", text(&sequence), "--out", text(&out), "--modes", "given"]));
        out.join("runs/room/given/0/report.json").metadata().unwrap().modified().unwrap()
    };
    let mut last = bench();
    assert_eq!(bench(), last, "a finished run was run again");
    let calibration = std::fs::read_to_string(sequence.join("calib.yaml")).unwrap();
    for (name, content) in [("calib.yaml", calibration.replace("5000", "5001")), ("groundtruth.txt", String::new())] {
        std::fs::write(sequence.join(name), content).unwrap();
        let now = bench();
        assert_ne!(now, last, "{name}");
        last = now;
    }
    std::fs::copy(sequence.join("mask/1305031104.175424.png"), sequence.join("mask/0.png")).unwrap();
    assert_ne!(bench(), last, "the true masks");
}

#[test]
fn a_bench_says_what_it_cannot_do() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, out) = (folder.path().join("room"), folder.path().join("out"));
    copy_with_masks(&sequence, 3);
    let bench = |more: &[&str]| {
        pfd_slam(&[&["bench", text(&sequence), "--out", text(&out), "--modes", "none"][..], more].concat())
    };
    for option in ["--vary", "--set"] {
        assert_fails_naming(&bench(&[option, "mode=paper"]), "use --modes");
    }
    assert_success(&bench(&["--vary", "segmentation.particles.count=500,600"]));
    assert_eq!(json(&out.join("bench.json")).as_array().unwrap().len(), 3);
    std::fs::remove_dir_all(sequence.join("mask")).unwrap();
    let given = pfd_slam(&["bench", text(&sequence), "--out", text(&out), "--modes", "given"]);
    assert_fails_naming(&given, "SEQUENCE/mask");
}

#[test]
fn broken_true_masks_leave_the_other_figures() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, out) = (folder.path().join("room"), folder.path().join("out"));
    copy_with_masks(&sequence, 3);
    std::fs::write(sequence.join("mask/1305031104.211283.png"), b"broken").unwrap();
    let output = pfd_slam(&["bench", text(&sequence), "--out", text(&out), "--modes", "none"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("room none: "));
    assert!(String::from_utf8_lossy(&output.stderr).contains("mask/1305031104.211283.png"));
    let runs = json(&out.join("bench.json"));
    assert_eq!((runs[0]["masks"].clone(), runs[0]["summary"]["frames"].as_u64()), (Value::Null, Some(3)));
    assert!(out.join("bench.html").exists());
}

/// Makes an image half as wide.
fn narrow(path: &Path) {
    let image = image::open(path).unwrap();
    image.crop_imm(0, 0, image.width() / 2, image.height()).save(path).unwrap();
}

#[test]
fn images_of_another_size_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, out) = (folder.path().join("room"), folder.path().join("out"));
    copy_with_masks(&sequence, 5);
    let run = |more: &[&str]| pfd_slam(&[&["run", text(&sequence), "--out", text(&out)][..], more].concat());
    let masks = sequence.join("mask");
    narrow(&masks.join("1305031104.175424.png"));
    let with_masks = run(&["--masks", text(&masks)]);
    assert_stops_naming(&with_masks, "mask/1305031104.175424.png: the mask is 320x480, its image 640x480");
    // The second colour image and the depth image nearest in time, which serves the third as well.
    for file in ["rgb/1305031104.211283.jpg", "depth/1305031104.227247.png"] {
        narrow(&sequence.join(file));
    }
    let output = run(&["--mode", "none"]);
    assert_success(&output);
    assert!(String::from_utf8_lossy(&output.stderr).contains("skipped: "));
    assert!(String::from_utf8_lossy(&output.stderr).contains("rgb/1305031104.211283.jpg: the image is 320x480"));
    assert_eq!(json(&out.join("report.json"))["skipped"], 2);
    let calibration = std::fs::read_to_string(sequence.join("calib.yaml")).unwrap();
    std::fs::write(sequence.join("calib.yaml"), calibration.replace("640", "600")).unwrap();
    let unfit = run(&[]);
    assert_fails_naming(&unfit, "rgb/1305031104.175424.jpg: the image is 640x480, and none is 600x480");
    assert_fails_naming(&unfit, "calib.yaml");
}

#[test]
fn images_of_one_name_have_masks_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, out) = (folder.path().join("room"), folder.path().join("out"));
    copy_with_masks(&sequence, 3);
    let list = std::fs::read_to_string(sequence.join("rgb.txt")).unwrap();
    let (first, second) = ("1305031104.175424.jpg", "1305031104.211283.jpg");
    std::fs::create_dir(sequence.join("other")).unwrap();
    std::fs::rename(sequence.join("rgb").join(second), sequence.join("other").join(first)).unwrap();
    let list = list.replace(&format!("rgb/{second}"), &format!("other/{first}"));
    std::fs::write(sequence.join("rgb.txt"), list).unwrap();
    let run = ["run", text(&sequence), "--out", text(&out), "--mode", "none"];
    assert_success(&pfd_slam(&[&run[..], &["--save-masks"]].concat()));
    let mut names: Vec<_> =
        std::fs::read_dir(out.join("masks")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names[..2], ["1305031104.175424.png", "1305031104.211283.png"]);
    assert_eq!(names.len(), 3);
    std::fs::remove_file(sequence.join("mask/1305031104.211283.png")).unwrap();
    let given = pfd_slam(&[&run[..], &["--masks", text(&sequence.join("mask"))]].concat());
    assert_stops_naming(&given, "mask/1305031104.211283.png: no mask with this name");
}

/// The nodes' files without masks: those of a run that saved none.
#[test]
fn a_report_without_masks_names_no_picture() {
    let out = tempfile::tempdir().unwrap();
    assert_success(&run_bundled(out.path(), &["--mode", "none"]));
    let printed = pfd_slam(&["report", text(&bundled_sequence()), text(out.path())]);
    assert_success(&printed);
    let printed = String::from_utf8(printed.stdout).unwrap();
    assert!(printed.contains("report: ") && printed.contains("(as given to `report`)"), "{printed}");
    assert!(!printed.contains("picture: ") && !out.path().join("picture.svg").exists(), "{printed}");
}

#[test]
fn a_bench_of_an_archive_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = folder.path().join("room");
    copy_frames(&sequence, 4);
    std::fs::copy(bundled_sequence().join("calib.yaml"), sequence.join("calib.yaml")).unwrap();
    let archive = folder.path().join("room.tgz");
    let tar = ["czf", text(&archive), "-C", text(folder.path()), "room"];
    assert!(Command::new("tar").args(tar).status().unwrap().success());
    let out = folder.path().join("out");
    let bench = || {
        assert_success(&pfd_slam(&["bench", text(&archive), "--modes", "none", "--out", text(&out)]));
        out.join("runs/room/none/0/report.json").metadata().unwrap().modified().unwrap()
    };
    assert_eq!(bench(), bench(), "a finished run was run again");
}

#[test]
fn a_signal_leaves_nothing_of_an_archive_behind() {
    /// 128 and the number of the signal.
    const STATUS: [(&str, i32); 2] = [("INT", 130), ("TERM", 143)];
    let folder = tempfile::tempdir().unwrap();
    let (archive, unpacked) = (folder.path().join("room.tgz"), folder.path().join("tmp"));
    let bundled = bundled_sequence();
    let tar = ["czf", text(&archive), "-C", text(bundled.parent().unwrap()), "composite-demo"];
    assert!(Command::new("tar").args(tar).status().unwrap().success());
    std::fs::create_dir(&unpacked).unwrap();
    let run = ["run", text(&archive), "--out", text(&folder.path().join("out"))].map(str::to_owned);
    let bench = ["bench", text(&archive), "--out", text(&folder.path().join("bench"))].map(str::to_owned);
    for (arguments, (signal, status)) in [run, bench].iter().zip(STATUS) {
        let mut child = start(programs::pfd_slam().unwrap().args(arguments).env("TMPDIR", &unpacked));
        assert_eq!(std::fs::read_dir(&unpacked).unwrap().count(), 1);
        let kill = [format!("-{signal}"), child.id().to_string()];
        assert!(Command::new("kill").args(kill).status().unwrap().success());
        assert_eq!(child.wait().unwrap().code(), Some(status));
        assert_eq!(std::fs::read_dir(&unpacked).unwrap().count(), 0, "{arguments:?}");
    }
}

#[test]
fn config_prints_what_it_reads() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("printed.yaml");
    for nodes in [&[][..], &["--nodes"]] {
        let printed = pfd_slam(&[&["config", "--set", "seed=5", "--set", "rgb_topic=/eye"][..], nodes].concat());
        assert_success(&printed);
        std::fs::write(&file, &printed.stdout).unwrap();
        let again = pfd_slam(&[&["config", "--config", text(&file)][..], nodes].concat());
        assert_success(&again);
        let printed = String::from_utf8(printed.stdout).unwrap();
        assert_eq!(String::from_utf8(again.stdout).unwrap(), printed);
        assert_eq!(printed.contains("acknowledge_topic"), !nodes.is_empty());
        assert_eq!(printed.contains("rgb_topic: \"/eye\""), !nodes.is_empty());
    }
}

#[test]
fn shipped_configurations_are_accepted() {
    for entry in std::fs::read_dir(repository().join("config")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "yaml") {
            let output = pfd_slam(&["config", "--config", text(&path)]);
            assert!(output.status.success(), "{}: {}", path.display(), String::from_utf8_lossy(&output.stderr));
        }
    }
}

/// evo's programs read our files and the ground truth as they are.
#[test]
fn evo_opens_our_trajectories() {
    let evo = |program: &str| Command::new(program);
    if evo("evo_ape").arg("--help").output().is_err() {
        pfd_tests::skip("evo_ape is not in PATH (pip install evo)");
        return;
    }
    let out = tempfile::tempdir().unwrap();
    assert_success(&run_bundled(out.path(), &["--mode", "none"]));
    let (truth, estimate) = (bundled_sequence().join("groundtruth.txt"), out.path().join("trajectory.txt"));
    for (program, arguments) in [
        ("evo_traj", vec!["tum", text(&estimate), "--ref", text(&truth), "--align"]),
        ("evo_ape", vec!["tum", text(&truth), text(&estimate), "--align"]),
        ("evo_rpe", vec!["tum", text(&truth), text(&estimate), "--delta", "5", "--delta_unit", "f"]),
    ] {
        assert_success(&evo(program).args(arguments).output().unwrap());
    }
}
