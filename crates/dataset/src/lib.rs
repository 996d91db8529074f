//! RGB-D sequences in TUM layout
