//! Row-major images without padding.

/// Why an image could not be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// The number of pixels is not width × height.
    #[error("an image of {width}x{height} needs {} pixels, got {pixels}", width * height)]
    SizeMismatch {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Pixels given.
        pixels: usize,
    },
}

/// A row-major image of `width × height` pixels.
#[derive(Debug, PartialEq, Eq, Default)]
pub struct Image<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

/// Not derived: what is derived makes a new image even in `clone_from`.
impl<T: Clone> Clone for Image<T> {
    fn clone(&self) -> Self {
        Self { width: self.width, height: self.height, data: self.data.clone() }
    }

    fn clone_from(&mut self, source: &Self) {
        (self.width, self.height) = (source.width, source.height);
        self.data.clone_from(&source.data);
    }
}

/// Colour, 8 bits per channel, order R, G, B.
pub type RgbImage = Image<[u8; 3]>;
/// Luma, 8 bits.
pub type GrayImage = Image<u8>;

impl<T> Image<T> {
    /// An image over existing pixels, row by row.
    ///
    /// # Errors
    /// [`ImageError::SizeMismatch`] when `data.len() != width * height`.
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Result<Self, ImageError> {
        if width.checked_mul(height) == Some(data.len()) {
            Ok(Self { width, height, data })
        } else {
            Err(ImageError::SizeMismatch { width, height, pixels: data.len() })
        }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// `(width, height)`.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[T] {
        &self.data
    }

    /// All pixels, row by row, writable.
    pub fn pixels_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// The pixels, by value.
    pub fn into_vec(self) -> Vec<T> {
        self.data
    }

    /// Row `v`.
    pub fn row(&self, v: usize) -> &[T] {
        &self.data[v * self.width..(v + 1) * self.width]
    }

    /// Row `v`, writable.
    pub fn row_mut(&mut self, v: usize) -> &mut [T] {
        &mut self.data[v * self.width..(v + 1) * self.width]
    }

    /// The pixel at column `u`, row `v`, if it is inside.
    pub fn get(&self, u: usize, v: usize) -> Option<&T> {
        if u < self.width { self.data.get(v * self.width + u) } else { None }
    }

    /// The pixel nearest to `(u, v)`, if that is inside the image.
    pub fn nearest(&self, u: f64, v: f64) -> Option<&T> {
        let (u, v) = (u.round(), v.round());
        if u >= 0.0 && v >= 0.0 { self.get(u as usize, v as usize) } else { None }
    }
}

impl<T: Clone> Image<T> {
    /// An image with every pixel set to `value`.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, data: vec![value; width * height] }
    }
}

impl<T> std::ops::Index<(usize, usize)> for Image<T> {
    type Output = T;
    /// The pixel at `(u, v)` = (column, row).
    fn index(&self, (u, v): (usize, usize)) -> &T {
        debug_assert!(u < self.width);
        &self.data[v * self.width + u]
    }
}

impl<T> std::ops::IndexMut<(usize, usize)> for Image<T> {
    fn index_mut(&mut self, (u, v): (usize, usize)) -> &mut T {
        debug_assert!(u < self.width);
        &mut self.data[v * self.width + u]
    }
}

impl RgbImage {
    /// Luma by the weights of ITU-R BT.601 in fixed point.
    pub fn to_gray(&self) -> GrayImage {
        let data = self
            .data
            .iter()
            .map(|&[r, g, b]| ((77 * u32::from(r) + 150 * u32::from(g) + 29 * u32::from(b) + 128) >> 8) as u8)
            .collect();
        GrayImage { width: self.width, height: self.height, data }
    }

    /// The channels as bytes R, G, B, R, G, B, ….
    pub fn as_bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.data)
    }
}

/// Depth in metres along the optical axis; `0.0` where there is no measurement.
///
/// Every value is finite and not negative: NaN, infinities and negative values become `0.0` on construction.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct DepthImage(Image<f32>);

impl DepthImage {
    /// Takes over an image in metres; whatever is not a positive finite number becomes "no measurement".
    pub fn from_metres(mut image: Image<f32>) -> Self {
        for depth in image.pixels_mut() {
            // Without a branch, so that several are compared at once.
            *depth = if *depth > 0.0 && *depth < f32::INFINITY { *depth } else { 0.0 };
        }
        Self(image)
    }

    /// Converts raw sensor units; `units_per_metre` is 5000 for TUM files and 1000 for `16UC1` messages.
    pub fn from_raw(image: &Image<u16>, units_per_metre: f32) -> Self {
        let data = image.pixels().iter().map(|&raw| f32::from(raw) / units_per_metre).collect();
        Self::from_metres(Image { width: image.width, height: image.height, data })
    }

    /// The underlying image.
    pub fn image(&self) -> &Image<f32> {
        &self.0
    }

    /// Depth at `(u, v)` in metres, if there is a measurement.
    pub fn at(&self, u: usize, v: usize) -> Option<f32> {
        self.0.get(u, v).copied().filter(|&d| d > 0.0)
    }

    /// Share of pixels with a measurement, 0 to 1.
    pub fn valid_fraction(&self) -> f64 {
        let valid = self.0.pixels().iter().filter(|&&d| d > 0.0).count();
        valid as f64 / self.0.pixels().len().max(1) as f64
    }
}

/// Which pixels are dynamic: [`Mask::DYNAMIC`] or [`Mask::STATIC`], nothing between.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Mask(GrayImage);

impl Mask {
    /// Value of a pixel that moves.
    pub const DYNAMIC: u8 = 255;
    /// Value of a pixel that does not.
    pub const STATIC: u8 = 0;

    /// A mask with nothing dynamic.
    pub fn empty(width: usize, height: usize) -> Self {
        Self(Image::filled(width, height, Self::STATIC))
    }

    /// Takes over an image; every value other than 0 counts as dynamic.
    pub fn from_image(mut image: GrayImage) -> Self {
        for value in image.pixels_mut() {
            *value = if *value == 0 { Self::STATIC } else { Self::DYNAMIC };
        }
        Self(image)
    }

    /// Sets the pixels, row by row, by whether each is dynamic.
    pub fn assign(&mut self, dynamic: impl Iterator<Item = bool>) {
        for (value, dynamic) in self.0.pixels_mut().iter_mut().zip(dynamic) {
            *value = if dynamic { Self::DYNAMIC } else { Self::STATIC };
        }
    }

    /// The underlying image: 255 = dynamic, 0 = static.
    pub fn image(&self) -> &GrayImage {
        &self.0
    }

    /// Whether `(u, v)` is dynamic; pixels outside are not.
    pub fn is_dynamic(&self, u: usize, v: usize) -> bool {
        self.0.get(u, v).is_some_and(|&m| m != Self::STATIC)
    }

    /// Marks `(u, v)`; ignored outside the image.
    pub fn set(&mut self, u: usize, v: usize, dynamic: bool) {
        if u < self.0.width() && v < self.0.height() {
            self.0[(u, v)] = if dynamic { Self::DYNAMIC } else { Self::STATIC };
        }
    }

    /// Share of dynamic pixels, 0 to 1.
    pub fn fraction(&self) -> f64 {
        // As many as a byte can count, so that whole registers of pixels are counted at once.
        const RUN: usize = u8::MAX as usize;
        let in_run = |run: &[u8]| run.iter().map(|&m| u8::from(m != Self::STATIC)).sum::<u8>();
        let dynamic: usize = self.0.pixels().chunks(RUN).map(|run| usize::from(in_run(run))).sum();
        dynamic as f64 / self.0.pixels().len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_is_checked() {
        assert!(Image::from_vec(2, 3, vec![0_u8; 6]).is_ok());
        assert!(Image::from_vec(2, 3, vec![0_u8; 5]).is_err());
        assert!(Image::from_vec(usize::MAX, 2, vec![0_u8; 5]).is_err());
    }

    #[test]
    fn clone_from_reuses_memory() {
        let source = Image::from_vec(2, 3, vec![7_u8; 6]).unwrap();
        let mut copy = Image::filled(3, 3, 0_u8);
        let memory = copy.pixels().as_ptr();
        copy.clone_from(&source);
        assert_eq!(copy, source);
        assert_eq!(copy.pixels().as_ptr(), memory);
    }

    #[test]
    fn access_outside_is_none() {
        let image = Image::from_vec(2, 1, vec![1_u8, 2]).unwrap();
        assert_eq!(image.get(1, 0), Some(&2));
        assert_eq!(image.get(2, 0), None);
        assert_eq!(image.get(0, 1), None);
        assert_eq!(image.nearest(-0.6, 0.0), None);
        assert_eq!(image.nearest(1.4, 0.4), Some(&2));
        assert_eq!(image.nearest(f64::NAN, 0.0), None);
    }

    #[test]
    fn depth_has_no_invalid_number() {
        let raw = vec![f32::NAN, f32::INFINITY, -1.0, 2.5];
        let depth = DepthImage::from_metres(Image::from_vec(4, 1, raw).unwrap());
        assert_eq!(depth.image().pixels(), [0.0, 0.0, 0.0, 2.5]);
        assert_eq!((depth.at(0, 0), depth.at(3, 0)), (None, Some(2.5)));
        assert!((depth.valid_fraction() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn gray_of_known_colours() {
        let rgb = Image::from_vec(3, 1, vec![[255, 255, 255], [255, 0, 0], [0, 0, 0]]).unwrap();
        assert_eq!(rgb.to_gray().pixels(), [255, 77, 0]);
    }

    #[test]
    fn mask_is_binary() {
        let mask = Mask::from_image(Image::from_vec(2, 1, vec![7, 0]).unwrap());
        assert_eq!(mask.image().pixels(), [255, 0]);
        assert!((mask.fraction() - 0.5).abs() < 1e-12);
        let all = Mask::from_image(Image::filled(64, 31, 1));
        assert!((all.fraction() - 1.0).abs() < 1e-12, "runs of pixels that are all dynamic are counted in a byte");
    }
}
