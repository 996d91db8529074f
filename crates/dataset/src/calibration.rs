//! Intrinsics: from `calib.yaml`, or from the name of a sequence of the benchmark.

use std::collections::BTreeMap;
use std::path::Path;

use pfd_geometry::{Camera, CameraError, Distortion};
use pfd_parameters::spelling;
use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::DatasetError;

/// Units per metre of the benchmark's depth images.
pub const TUM_DEPTH_FACTOR: f64 = 5000.0;

/// A camera without its image size, and the scale of its depth images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Columns and rows, where stated.
    pub size: Option<(usize, usize)>,
    /// `fx fy cx cy`, pixels.
    pub intrinsics: [f64; 4],
    /// Lens distortion.
    pub distortion: Distortion,
    /// Depth units per metre, where stated.
    pub depth_factor: Option<f64>,
}

/// Names that other files have for what is read here. To ignore one would mean wrong depth or a lens that bends.
const OTHER_NAMES: [(&str, &str); 9] = [
    ("depth_scale", "depth_factor"),
    ("depth_unit", "depth_factor"),
    ("depth_units", "depth_factor"),
    ("depth_map_factor", "depth_factor"),
    ("distortion_coefficients", "distortion"),
    ("distortion_coeffs", "distortion"),
    ("dist_coeffs", "distortion"),
    ("k1", "distortion"),
    ("p1", "distortion"),
];

/// Keys of `calib.yaml`; keys that are not listed (frame rate, notes) are ignored, unless they look like a slip.
#[derive(Deserialize)]
struct File {
    #[serde(alias = "image_width")]
    width: Option<usize>,
    #[serde(alias = "image_height")]
    height: Option<usize>,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    distortion: Vec<f64>,
    distortion_model: Option<String>,
    camera_model: Option<String>,
    depth_factor: Option<f64>,
}

impl File {
    /// All names of its fields.
    const KEYS: [&str; 12] = [
        "width",
        "image_width",
        "height",
        "image_height",
        "fx",
        "fy",
        "cx",
        "cy",
        "distortion",
        "distortion_model",
        "camera_model",
        "depth_factor",
    ];
}

impl Calibration {
    /// Reads `calib.yaml`.
    ///
    /// # Errors
    /// When the file cannot be read or does not describe a pinhole camera.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let text = std::fs::read_to_string(path).map_err(DatasetError::io(path))?;
        Self::parse(&text).map_err(|reason| DatasetError::Calibration { path: path.to_owned(), reason })
    }

    /// Parses the text of `calib.yaml`.
    ///
    /// # Errors
    /// The reason, with the key at fault.
    pub fn parse(text: &str) -> Result<Self, String> {
        // Without the excerpt of the file: error messages are one line.
        let file: File = serde_saphyr::from_str(text).map_err(|e| e.without_snippet().to_string())?;
        check_keys(text)?;
        if file.width.is_some() != file.height.is_some() {
            return Err("of width and height there is one: both are needed, or none for those of the images".to_owned());
        }
        if let Some(model) = file.camera_model.filter(|m| m != "pinhole") {
            return Err(format!("camera_model `{model}` is not supported: pinhole is"));
        }
        if let Some(factor) = file.depth_factor.filter(|f| !(f.is_finite() && *f > 0.0)) {
            return Err(format!("depth_factor {factor} must be positive: units per metre, 5000 for TUM files"));
        }
        let calibration = Self {
            size: file.width.zip(file.height),
            intrinsics: [file.fx, file.fy, file.cx, file.cy],
            distortion: distortion(file.distortion_model.as_deref(), &file.distortion)?,
            depth_factor: file.depth_factor,
        };
        // The size is filled in from the first image where the file does not state it; here any size serves the check.
        calibration.camera(calibration.size.unwrap_or((1, 1))).map_err(|e| e.to_string())?;
        Ok(calibration)
    }

    /// The camera of a sequence of the benchmark, by the name of its folder: `freiburg1` or `fr1`, and so on (Sturm et al.,
    /// calibration table on the benchmark's site).
    pub fn of_name(name: &str) -> Option<Self> {
        let name = name.to_lowercase();
        let known = |number: &str| {
            let matches = |prefix: &str| {
                let tag = format!("{prefix}{number}");
                name.match_indices(&tag)
                    .any(|(at, _)| !name[at + tag.len()..].starts_with(|c: char| c.is_ascii_digit()))
            };
            matches("freiburg") || matches("fr")
        };
        let (intrinsics, distortion) = if known("1") {
            ([517.3, 516.5, 318.6, 255.3], [0.2624, -0.9531, -0.0054, 0.0026, 1.1633])
        } else if known("2") {
            ([520.9, 521.0, 325.1, 249.7], [0.2312, -0.7849, -0.0033, -0.0001, 0.9172])
        } else if known("3") {
            ([535.4, 539.2, 320.1, 247.6], [0.0; 5])
        } else {
            return None;
        };
        let distortion = Distortion(distortion);
        Some(Self { size: Some((640, 480)), intrinsics, distortion, depth_factor: Some(TUM_DEPTH_FACTOR) })
    }

    /// The camera for images of `size`.
    ///
    /// # Errors
    /// When the numbers are not those of a camera.
    pub fn camera(&self, size: (usize, usize)) -> Result<Camera, CameraError> {
        Camera::new(size, self.intrinsics, self.distortion)
    }
}

/// Refuses a key that would be ignored although it looks like one that is read.
// A set would be read from a list, not from the keys of a mapping.
#[allow(clippy::zero_sized_map_values)]
fn check_keys(text: &str) -> Result<(), String> {
    let keys: BTreeMap<String, IgnoredAny> =
        serde_saphyr::from_str(text).map_err(|e| e.without_snippet().to_string())?;
    for key in keys.keys().filter(|key| !File::KEYS.contains(&key.as_str())) {
        let other_name = OTHER_NAMES.iter().find(|(name, _)| name == key).map(|(_, meant)| *meant);
        if let Some(meant) = other_name.or(spelling::similar(key, File::KEYS)) {
            return Err(format!("unknown key `{key}`: `{meant}` may be meant; rename it, or comment it out"));
        }
    }
    Ok(())
}

fn distortion(model: Option<&str>, coefficients: &[f64]) -> Result<Distortion, String> {
    const SUPPORTED: [&str; 4] = ["radtan", "plumb_bob", "radial-tangential", "none"];
    if let Some(model) = model.filter(|m| !SUPPORTED.contains(m)) {
        return Err(format!("distortion_model `{model}` is not supported: {} are", SUPPORTED.join(", ")));
    }
    if model == Some("none") && coefficients.iter().any(|&k| k != 0.0) {
        return Err("distortion_model is `none`, but distortion is not 0: state radtan, or no distortion".to_owned());
    }
    let mut all = [0.0; 5];
    match coefficients.len() {
        0 | 4 | 5 => all[..coefficients.len()].copy_from_slice(coefficients),
        n => return Err(format!("distortion has {n} coefficients: 4 or 5 (k1 k2 p1 p2 k3) are expected")),
    }
    Ok(Distortion(all))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RADTAN: &str = "width: 640\nheight: 480\nfx: 517.3\nfy: 516.5\ncx: 318.6\ncy: 255.3\n\
        distortion_model: radtan   # k1 k2 p1 p2 k3\ndistortion: [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]\ndepth_factor: 5000\n";
    const PINHOLE: &str = "camera_model: pinhole\nimage_width: 320\nimage_height: 240\nfx: 535\nfy: 539.2\ncx: 320.1\n\
        cy: 247.6\ndistortion: [0, 0, 0, 0, 0]\ndepth_factor: 1000.0\nfps: 30\nbaseline_disparity_m: 0.075\n";

    #[test]
    fn reads_both_sets_of_keys() {
        let radtan = Calibration::parse(RADTAN).unwrap();
        assert_eq!(Some(radtan), Calibration::of_name("rgbd_dataset_freiburg1_xyz"));
        let pinhole = Calibration::parse(PINHOLE).unwrap();
        assert_eq!(pinhole.size, Some((320, 240)));
        assert_eq!(pinhole.depth_factor, Some(1000.0));
        assert!(pinhole.distortion.is_zero());
    }

    #[test]
    fn names_the_key_at_fault() {
        for (text, part) in [
            ("fx: 1\nfy: 1\ncx: 1\n", "cy"),
            ("fx: 0\nfy: 1\ncx: 1\ncy: 1\n", "fx 0"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\ndistortion: [1, 2]\n", "2 coefficients"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\ndistortion_model: fisheye\n", "fisheye"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\ndepth_factor: -1\n", "depth_factor"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\ncamera_model: omni\n", "omni"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\ndistorsion: [0, 0, 0, 0]\n", "`distorsion`: `distortion` may be meant"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\ndepth_scale: 1000\n", "`depth_scale`: `depth_factor` may be meant"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\nwidht: 640\nheight: 480\n", "both are needed"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\nwidths: 640\n", "`widths`: `width` may be meant"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\nwidth: 640\n", "both are needed"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\ndistortion_model: none\ndistortion: [0, 1, 0, 0]\n", "not 0"),
        ] {
            let reason = Calibration::parse(text).unwrap_err();
            assert!(reason.contains(part), "{reason}");
            assert!(!reason.contains('\n'), "{reason}");
        }
    }

    #[test]
    fn other_keys_are_ignored() {
        let text = format!("{PINHOLE}notes: {{a: [1, 2]}}\nserial: 17\nexposure: auto\ndepth_noise: 0.001\n1: one\n");
        assert_eq!(Calibration::parse(&text), Calibration::parse(PINHOLE));
        let text = "fx: 1\nfy: 1\ncx: 1\ncy: 1\ndistortion_model: none\ndistortion: [0, 0, 0, 0]\n";
        assert!(Calibration::parse(text).unwrap().distortion.is_zero());
    }

    #[test]
    fn knows_the_benchmarks_cameras_by_name() {
        let fx = |name| Calibration::of_name(name).map(|c| c.intrinsics[0]);
        assert_eq!(fx("rgbd_dataset_freiburg3_walking_xyz"), Some(535.4));
        assert_eq!(fx("tum-fr1-xyz-first180"), Some(517.3));
        assert_eq!(fx("FR2_desk"), Some(520.9));
        assert_eq!(fx("fr10"), None);
        assert_eq!(fx("kitchen"), None);
    }

    proptest! {
        #[test]
        fn any_text_parses_or_is_refused(text in "((fx|fy|cx|cy|width|distortion): ?[0-9a-z.\\[\\], -]{0,10}\n){0,8}") {
            let _ = Calibration::parse(&text);
        }
    }
}
