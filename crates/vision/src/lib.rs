//! Image operations; the only crate that links OpenCV
