//! Motion segmentation by rigid ego-motion: the engine of mode `pfd`.

mod colours;
mod continuity;
mod corners;
mod credibility;
mod diffusion;
mod disjoint_sets;
mod ego_motion;
mod evidence;
mod exposure;
mod large_planes;
mod luma;
mod missing_depth;
mod model_alignment;
mod motion;
mod objects;
mod planes;
mod reference;
mod regions;
mod rematch;
mod report;
mod rim;
mod segmenter;
mod static_model;
mod surfaces;
mod territories;
mod things;
mod unchanged;
mod undecided;
mod view;
mod votes;
mod witness;

pub(crate) use segmenter::{Outcome, RigidSegmenter};
