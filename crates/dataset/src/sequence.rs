//! A recorded sequence: frames, camera, ground truth.

use std::path::{Path, PathBuf};

use pfd_geometry::{Camera, DepthImage, RgbdFrame, Stamp, StampedPose, association, trajectory};
use tempfile::TempDir;

use crate::calibration::{Calibration, TUM_DEPTH_FACTOR};
use crate::image_list::{self, ListedImage};
use crate::{DatasetError, archive, images};

/// Which depth image belongs to a colour image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Pairing {
    /// The nearest in time. Where the depth stream has a gap a depth image serves two colour images, so that every colour image
    /// with depth near it is a frame.
    #[default]
    Nearest,
    /// The rule of the benchmark's `associate.py`: closest first, each image at most once; some colour images are dropped.
    OneToOne,
}

/// How a sequence is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Seconds added to the depth stamps before they are compared with the colour stamps.
    pub depth_offset: f64,
    /// Largest time between colour and depth of a frame, seconds.
    pub max_difference: f64,
    /// Which depth image belongs to a colour image.
    pub pairing: Pairing,
}

impl Default for Options {
    /// The benchmark's: 0.02 s, no offset.
    fn default() -> Self {
        Self { depth_offset: 0.0, max_difference: 0.02, pairing: Pairing::default() }
    }
}

/// One frame on disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Association {
    /// Stamp of the colour image, which is that of the frame.
    pub rgb_stamp: Stamp,
    /// File of the colour image.
    pub rgb_path: PathBuf,
    /// Stamp of the depth image as recorded, without offset.
    pub depth_stamp: Stamp,
    /// File of the depth image.
    pub depth_path: PathBuf,
}

/// A sequence in TUM layout.
#[derive(Debug)]
pub struct Sequence {
    name: String,
    path: PathBuf,
    folder: PathBuf,
    pairs: Vec<Association>,
    unpaired: usize,
    camera: Option<Camera>,
    depth_factor: f64,
    ground_truth: Option<Vec<StampedPose>>,
    /// Where an archive was unpacked; removed with the sequence.
    _unpacked: Option<TempDir>,
}

impl Sequence {
    /// Opens a folder or a `.tgz` with the default options.
    ///
    /// # Errors
    /// See [`Sequence::open_with`].
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        Self::open_with(path, &Options::default())
    }

    /// Opens a folder or a `.tgz` (unpacked to a temporary folder).
    ///
    /// # Errors
    /// When a list is missing, malformed or unsorted, `calib.yaml` is no camera, the archive is unsafe, or no colour image has
    /// depth. Images are not read here: see [`Sequence::frame`].
    pub fn open_with(path: &Path, options: &Options) -> Result<Self, DatasetError> {
        let (folder, unpacked) = locate(path)?;
        let rgb = image_list::read(&folder.join("rgb.txt"))?;
        let depth = image_list::read(&folder.join("depth.txt"))?;
        let pairs = pair_up(&folder, &rgb, &depth, options);
        if pairs.is_empty() {
            let Options { max_difference, depth_offset: offset, .. } = *options;
            return Err(DatasetError::NoPairs { path: folder, rgb: rgb.len(), max_difference, offset });
        }
        let name = name_of(path);
        let calibration = calibration(&folder, &name)?;
        Ok(Self {
            camera: calibration.map(|c| camera(&c, &folder, &pairs)).transpose()?,
            depth_factor: calibration.and_then(|c| c.depth_factor).unwrap_or(TUM_DEPTH_FACTOR),
            ground_truth: ground_truth(&folder.join("groundtruth.txt"))?,
            unpaired: rgb.len() - pairs.len(),
            name,
            path: path.to_owned(),
            folder,
            pairs,
            _unpacked: unpacked,
        })
    }

    /// Name of the folder or archive, without `.tgz`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The folder or archive that was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The folder with the files (a temporary one for an archive).
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The camera by `calib.yaml`, else by the name of the sequence; `None` when neither tells.
    pub fn camera(&self) -> Option<Camera> {
        self.camera
    }

    /// Depth units per metre: of `calib.yaml`, else 5000.
    pub fn depth_factor(&self) -> f64 {
        self.depth_factor
    }

    /// Number of frames: colour images with depth.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there is no frame; never, for an open sequence.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Number of colour images that are no frame, because no depth image is near enough.
    pub fn unpaired(&self) -> usize {
        self.unpaired
    }

    /// Files and stamps of frame `i`.
    ///
    /// # Panics
    /// When `i` is not below [`Sequence::len`].
    pub fn pair(&self, i: usize) -> &Association {
        &self.pairs[i]
    }

    /// Files and stamps of all frames.
    pub fn pairs(&self) -> &[Association] {
        &self.pairs
    }

    /// The recorded camera poses, where known.
    pub fn ground_truth(&self) -> Option<&[StampedPose]> {
        self.ground_truth.as_deref()
    }

    /// Reads frame `i`.
    ///
    /// # Errors
    /// When an image cannot be read, or colour and depth differ in size. Other frames may be fine.
    pub fn frame(&self, i: usize) -> Result<RgbdFrame, DatasetError> {
        let pair = self.pairs.get(i).ok_or(DatasetError::OutOfRange { index: i, len: self.len() })?;
        let rgb = images::read_color(&pair.rgb_path)?;
        let depth = DepthImage::from_raw(&images::read_depth(&pair.depth_path)?, self.depth_factor as f32);
        RgbdFrame::new(pair.rgb_stamp, rgb, depth)
            .map_err(|error| DatasetError::Frame { path: pair.depth_path.clone(), error })
    }

    /// Reads the frames in order; a broken image is an `Err` in its place and the others follow.
    pub fn frames(&self) -> impl Iterator<Item = Result<RgbdFrame, DatasetError>> + '_ {
        (0..self.len()).map(|i| self.frame(i))
    }
}

/// The folder that holds `rgb.txt`, unpacked first where `path` is an archive.
fn locate(path: &Path) -> Result<(PathBuf, Option<TempDir>), DatasetError> {
    let metadata = std::fs::metadata(path).map_err(DatasetError::io(path))?;
    let not_a_sequence = || DatasetError::NotASequence { path: path.to_owned() };
    if metadata.is_dir() {
        let found = folder_with_lists(path).ok_or_else(not_a_sequence)?;
        return Ok((found, None));
    }
    if !is_archive(path) {
        return Err(not_a_sequence());
    }
    let unpacked = tempfile::Builder::new().prefix("pfd-slam-").tempdir().map_err(DatasetError::io(path))?;
    archive::unpack(path, unpacked.path(), archive::Limits::default())?;
    let found = folder_with_lists(unpacked.path()).ok_or_else(not_a_sequence)?;
    Ok((found, Some(unpacked)))
}

fn is_archive(path: &Path) -> bool {
    let has = |path: &Path, extension: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
    has(path, "tgz") || has(path, "gz") && path.file_stem().is_some_and(|stem| has(Path::new(stem), "tar"))
}

/// The folder itself, or the only folder in it (archives hold the sequence in one), if it has `rgb.txt` or `depth.txt`.
fn folder_with_lists(folder: &Path) -> Option<PathBuf> {
    let has_lists = |f: &Path| f.join("rgb.txt").is_file() || f.join("depth.txt").is_file();
    if has_lists(folder) {
        return Some(folder.to_owned());
    }
    let mut inner = std::fs::read_dir(folder).ok()?.flatten().map(|e| e.path()).filter(|f| has_lists(f));
    let found = inner.next()?;
    inner.next().is_none().then_some(found)
}

fn name_of(path: &Path) -> String {
    // A path such as `.` has a name only in its absolute form.
    let absolute = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = absolute.file_name().unwrap_or_default().to_string_lossy().into_owned();
    name.strip_suffix(".tgz").or(name.strip_suffix(".tar.gz")).map_or(name.clone(), str::to_owned)
}

fn pair_up(folder: &Path, rgb: &[ListedImage], depth: &[ListedImage], options: &Options) -> Vec<Association> {
    let rgb_stamps: Vec<Stamp> = rgb.iter().map(|image| image.stamp).collect();
    let depth_stamps: Vec<Stamp> = depth.iter().map(|image| image.stamp.offset_by(options.depth_offset)).collect();
    let rule = match options.pairing {
        Pairing::Nearest => association::nearest,
        Pairing::OneToOne => association::one_to_one,
    };
    let join = |(i, j): (usize, usize)| Association {
        rgb_stamp: rgb[i].stamp,
        rgb_path: folder.join(&rgb[i].path),
        depth_stamp: depth[j].stamp,
        depth_path: folder.join(&depth[j].path),
    };
    rule(&rgb_stamps, &depth_stamps, options.max_difference).into_iter().map(join).collect()
}

fn calibration(folder: &Path, name: &str) -> Result<Option<Calibration>, DatasetError> {
    let file = folder.join("calib.yaml");
    if file.exists() {
        return Calibration::read(&file).map(Some);
    }
    Ok(Calibration::of_name(name).or_else(|| Calibration::of_name(&name_of(folder))))
}

/// The camera; its size is that of the first readable image where the calibration does not state it.
fn camera(calibration: &Calibration, folder: &Path, pairs: &[Association]) -> Result<Camera, DatasetError> {
    let first_size = || pairs.iter().find_map(|pair| images::size(&pair.rgb_path).ok());
    let fail = |reason: String| DatasetError::Calibration { path: folder.join("calib.yaml"), reason };
    let size = calibration
        .size
        .or_else(first_size)
        .ok_or_else(|| fail("width and height are missing and no colour image can be read".to_owned()))?;
    calibration.camera(size).map_err(|e| fail(e.to_string()))
}

fn ground_truth(path: &Path) -> Result<Option<Vec<StampedPose>>, DatasetError> {
    if !path.exists() {
        return Ok(None);
    }
    let text = std::fs::read_to_string(path).map_err(DatasetError::io(path))?;
    let poses = trajectory::parse(&text).map_err(|e| DatasetError::Line {
        path: path.to_owned(),
        line: e.line,
        reason: e.reason,
    })?;
    Ok(Some(poses))
}
