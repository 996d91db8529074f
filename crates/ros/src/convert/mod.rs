//! Between messages and the types of the algorithms. Messages from the wire are untrusted: sizes are checked before anything is
//! allocated.

pub mod camera;
pub mod compressed;
pub mod image;
pub mod map;
pub mod pose;
pub mod regions;

pub use camera::{camera_from_info, camera_to_info};
pub use compressed::{depth_from_compressed, rgb_from_compressed};
pub use image::{
    ConvertError, depth_from_image, depth_to_metres, depth_to_millimetres, mask_from_image, mask_to_image,
    rgb_from_image, rgb_to_image,
};
