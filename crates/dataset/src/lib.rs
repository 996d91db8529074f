//! RGB-D sequences in the layout of the TUM RGB-D benchmark (Sturm et al., IROS 2012), as a folder or its `.tgz`.
//!
//! ```text
//! rgb.txt, depth.txt      lines `stamp file`, sorted by stamp; `#` starts a comment
//! groundtruth.txt         lines `stamp tx ty tz qx qy qz qw`, camera to world; optional
//! calib.yaml              intrinsics; optional for sequences of the benchmark, which are known by name
//! rgb/, depth/            PNG or JPEG colour, 16-bit PNG depth registered to it
//! ```

pub mod archive;
pub mod calibration;
pub mod error;
pub mod image_list;
pub mod images;
pub mod sequence;

pub use calibration::Calibration;
pub use error::DatasetError;
pub use sequence::{Association, Options, Pairing, Sequence};
