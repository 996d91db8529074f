//! Reports: what `report.json`, `frames.csv` and the self-contained HTML pages hold and look like.

pub mod bench;
pub mod bench_page;
pub mod bench_summary;
pub mod bench_tables;
pub mod error;
pub mod figures;
pub mod frames;
pub mod html;
pub mod page;
pub mod picture;
pub mod plot;
pub mod published;
pub mod sample;
pub mod summary;
pub mod table;
pub mod video;

pub use error::ReportError;
pub use frames::FrameRow;
pub use page::RunPage;
pub use sample::Sample;
pub use summary::{Percentiles, Summary, Timing};
pub use video::Video;
