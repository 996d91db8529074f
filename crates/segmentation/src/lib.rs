//! Dynamic-region segmentation without a learned prior (PFD-SLAM, sections 3.1 and 3.2)
