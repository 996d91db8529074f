//! Segmentation and tracking composed, with observers
