//! RGB-D tracking and mapping
