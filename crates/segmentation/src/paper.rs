//! Algorithm 2: dynamic segmentation by particle filter and depth (paper, section 3.2), the modes `paper` and `single`; and
//! mode `flow`, which stops after the feature tests of algorithm 1.

use std::ops::Range;

use nalgebra::{Matrix3, Vector2};
use pfd_geometry::{DepthImage, GrayImage, Image, Mask, RgbdFrame, StageTimes};
use pfd_vision::VisionError;
use pfd_vision::contours::{Contour, largest_contour};
use pfd_vision::warp::gaussian_smooth;

use crate::clustering;
use crate::config::{Mode, PaperConfig, SegmentationConfig};
use crate::inter_frame::{InterFrame, Transformation, difference};
use crate::kmeans::kmeans;
use crate::particle_filter::{Particle, ParticleFilter, statistics};
use crate::result::{BoundingBox, DynamicRegion, FailOpenReason, Status};

/// The published method.
#[derive(Debug)]
pub(crate) struct PaperSegmenter {
    config: PaperConfig,
    kernel_sigma: f64,
    size: (usize, usize),
    features_only: bool,
    inter_frame: InterFrame,
    /// One filter per object: the first follows the strongest, the next what the first leaves over (step 9).
    filters: Vec<ObjectFilter>,
    next_id: u32,
    /// Time of the last frame, seconds.
    before: Option<f64>,
    buffers: Buffers,
}

/// Images that live as long as the segmenter.
#[derive(Debug)]
struct Buffers {
    /// Luma of the last frame.
    previous: GrayImage,
    /// What Eq. 1 gives, without the objects that have been found.
    difference: GrayImage,
    /// The same, smoothed by the kernel of Eq. 3.
    smooth: GrayImage,
    /// The depth interval within the ROI.
    binary: Mask,
}

impl Buffers {
    fn new((width, height): (usize, usize)) -> Self {
        let black = Image::filled(width, height, 0);
        Self { previous: black.clone(), difference: black.clone(), smooth: black, binary: Mask::empty(width, height) }
    }
}

/// What one frame gives.
#[derive(Debug, Default)]
pub(crate) struct PaperResult {
    pub(crate) regions: Vec<DynamicRegion>,
    pub(crate) particles: Vec<Vec<[f32; 2]>>,
}

/// Frames never lie closer in time than this, seconds.
const MIN_DT: f64 = 1e-3;
/// Points that determine a fundamental matrix.
const MIN_POINTS: usize = 8;
/// Radius of the disc that mode `flow` masks around a rejected feature, pixels.
const FEATURE_RADIUS: i64 = 6;
/// The depth interval spans this many standard deviations of the particles' depths on either side.
const INTERVAL_SIGMAS: f32 = 2.0;
/// Narrowest half interval, metres: the thickness of a body, whose front the particles see.
const MIN_HALF_INTERVAL: f32 = 0.15;
/// A contour smaller than this share of the image is no object.
const MIN_AREA: f64 = 0.002;

/// The region of an object: its outline and its depth interval in metres.
type Located = (Contour, [f32; 2]);

/// Columns and rows.
type Rectangle = (Range<usize>, Range<usize>);

/// A filter and the identity of the object that it follows.
#[derive(Debug)]
struct ObjectFilter {
    filter: ParticleFilter,
    id: u32,
}

impl PaperSegmenter {
    pub(crate) fn new(size: (usize, usize), mode: Mode, config: &SegmentationConfig, seed: u64) -> Self {
        let objects = if mode == Mode::Single { 1 } else { config.paper.max_objects };
        let filter = |k: usize| ObjectFilter {
            filter: ParticleFilter::new(size, config.particles, seed.wrapping_add(k as u64)),
            id: k as u32,
        };
        Self {
            config: config.paper,
            kernel_sigma: config.particles.kernel_sigma,
            size,
            features_only: mode == Mode::Flow,
            inter_frame: InterFrame::new(config.paper),
            filters: (0..objects).map(filter).collect(),
            next_id: objects as u32,
            before: None,
            buffers: Buffers::new(size),
        }
    }

    /// Processes one frame (`time` in seconds), drawing into `mask`.
    pub(crate) fn step(
        &mut self,
        frame: &RgbdFrame,
        time: f64,
        mask: &mut Mask,
        timing: &mut StageTimes,
    ) -> Result<(Status, PaperResult), VisionError> {
        let transformation = timing.measure("inter_frame", || self.inter_frame.step(frame.gray()))?;
        let before = self.before.replace(time);
        let found = match before {
            Some(before) => self.find(transformation, frame, (time - before).max(MIN_DT), mask, timing)?,
            None => (Status::FirstFrame, PaperResult::default()),
        };
        self.buffers.previous.clone_from(frame.gray());
        Ok(found)
    }

    /// What moves between the previous frame and this one, `dt` seconds later, given their transformation if there is one.
    fn find(
        &mut self,
        transformation: Option<Transformation>,
        frame: &RgbdFrame,
        dt: f64,
        mask: &mut Mask,
        timing: &mut StageTimes,
    ) -> Result<(Status, PaperResult), VisionError> {
        let few = |inliers| {
            (Status::FailedOpen(FailOpenReason::FewInliers { inliers, needed: MIN_POINTS }), PaperResult::default())
        };
        let Some(found) = transformation else { return Ok(few(0)) };
        if self.features_only {
            found.rejected.iter().for_each(|&p| draw_disc(mask, p));
            return Ok((Status::Segmented, PaperResult::default()));
        }
        let Some(homography) = found.homography else { return Ok(few(found.inliers)) };
        let result = timing.measure("objects", || self.objects(frame, &homography, dt, mask))?;
        Ok((Status::Segmented, result))
    }

    /// Steps 2 to 9: one object after the other.
    fn objects(
        &mut self,
        frame: &RgbdFrame,
        homography: &Matrix3<f64>,
        dt: f64,
        mask: &mut Mask,
    ) -> Result<PaperResult, VisionError> {
        let Buffers { previous, difference: image, .. } = &mut self.buffers;
        difference(previous, frame.gray(), homography, self.config.noise_floor, image)?;
        let mut result = PaperResult::default();
        for k in 0..self.filters.len() {
            gaussian_smooth(&self.buffers.difference, self.kernel_sigma, &mut self.buffers.smooth)?;
            let filter = &mut self.filters[k].filter;
            filter.predict(dt); // step 2
            let under_particles = filter.weigh(&self.buffers.smooth); // step 3
            filter.resample(); // step 4
            if under_particles < self.config.min_evidence {
                self.give_up(k);
                continue;
            }
            let members = self.largest_cluster(k);
            let Some((contour, interval)) = self.locate(&members, frame.depth())? else {
                // Step 9 goes on with what lies elsewhere.
                fill(&mut self.buffers.difference, extent(&members), 0);
                self.give_up(k);
                continue;
            };
            fill(&mut self.buffers.difference, bounds(&contour), 0); // step 8
            let pixels = self.draw(frame.depth(), &contour, interval, mask);
            result.particles.push(members.iter().map(|p| [p.x, p.y]).collect());
            result.regions.push(region((self.filters[k].id, pixels), &contour, interval, &members));
        }
        Ok(result)
    }

    /// Lets a filter look for another object.
    fn give_up(&mut self, k: usize) {
        self.filters[k].filter.scatter();
        self.filters[k].id = self.next_id;
        self.next_id += 1;
    }

    /// Step 5: the particles of the largest cluster.
    fn largest_cluster(&self, k: usize) -> Vec<Particle> {
        let particles = self.filters[k].filter.particles();
        let largest = clustering::clusters(particles, self.size).into_iter().next().unwrap_or_default();
        largest.into_iter().map(|i| particles[i]).collect()
    }

    /// Steps 6 and 7: clusters the depths of the particles, and cuts out the region.
    fn locate(&mut self, members: &[Particle], depth: &DepthImage) -> Result<Option<Located>, VisionError> {
        let Some(interval) = self.depth_interval(members, depth) else { return Ok(None) };
        let (columns, _) = extent(members);
        // The ROI has the full height of the image and the width of the cluster (section 3.2).
        let (width, depths) = (self.size.0, depth.image().pixels());
        let is_near = |z: f32| z > 0.0 && (interval[0]..=interval[1]).contains(&z);
        let inside = depths.iter().enumerate().map(|(i, &z)| columns.contains(&(i % width)) && is_near(z));
        self.buffers.binary.assign(inside);
        let min_area = MIN_AREA * (self.size.0 * self.size.1) as f64;
        let contour = largest_contour(&self.buffers.binary)?.filter(|c| c.area >= min_area);
        Ok(contour.map(|c| (c, interval)))
    }

    /// Step 6: the interval of the largest depth cluster.
    fn depth_interval(&self, members: &[Particle], depth: &DepthImage) -> Option<[f32; 2]> {
        let depths: Vec<f32> =
            members.iter().filter_map(|p| depth.at(p.x.max(0.0) as usize, p.y.max(0.0) as usize)).collect();
        let largest = kmeans(&depths, self.config.depth_clusters).into_iter().max_by_key(|c| c.count)?;
        let half = (INTERVAL_SIGMAS * largest.sigma).max(MIN_HALF_INTERVAL);
        Some([largest.center - half, largest.center + half])
    }

    /// Masks the rectangle; points near its border are decided by K-means of depth (last step of section 3.2). Returns how many pixels
    /// are the object's.
    fn draw(&self, depth: &DepthImage, contour: &Contour, interval: [f32; 2], mask: &mut Mask) -> u32 {
        let mut drawn = 0;
        let (x, y) = (contour.x as usize, contour.y as usize);
        let (right, bottom) = (x + contour.width as usize, y + contour.height as usize);
        let border = self.config.border as usize;
        let near_border =
            |u: usize, v: usize| u < x + border || v < y + border || u + border >= right || v + border >= bottom;
        let pixels = || (y..bottom).flat_map(move |v| (x..right).map(move |u| (u, v)));
        let band = pixels().filter(|&(u, v)| near_border(u, v)).step_by(BORDER_SAMPLING);
        let depths: Vec<f32> = band.filter_map(|(u, v)| depth.at(u, v)).collect();
        let centers: Vec<f32> = kmeans(&depths, 2).iter().map(|c| c.center).collect();
        let middle = 0.5 * (interval[0] + interval[1]);
        let own = centers.iter().copied().min_by(|a, b| (a - middle).abs().total_cmp(&(b - middle).abs()));
        for (u, v) in pixels() {
            let foreign = near_border(u, v)
                && depth
                    .at(u, v)
                    .zip(own)
                    .is_some_and(|(z, own)| centers.iter().any(|c| (c - z).abs() < (own - z).abs()));
            if !foreign {
                mask.set(u, v, true);
                drawn += 1;
            }
        }
        drawn
    }
}

/// Every how many border pixels enter K-means.
const BORDER_SAMPLING: usize = 5;

fn region((id, pixel_count): (u32, u32), contour: &Contour, interval: [f32; 2], members: &[Particle]) -> DynamicRegion {
    let (mean, covariance) = statistics(members);
    let Contour { x, y, width, height, .. } = *contour;
    DynamicRegion {
        id,
        bounding_box: BoundingBox { x, y, width, height },
        depth_interval: interval,
        pixel_count,
        particle_mean: mean,
        particle_covariance: covariance,
        image_velocity: Vector2::new(mean[2], mean[3]),
    }
}

/// The bounding rectangle of an outline.
fn bounds(&Contour { x, y, width, height, .. }: &Contour) -> Rectangle {
    (x as usize..(x + width) as usize, y as usize..(y + height) as usize)
}

/// The bounding rectangle of particles.
fn extent(particles: &[Particle]) -> Rectangle {
    let range = |of: fn(&Particle) -> f32| {
        let low = particles.iter().map(of).fold(f32::INFINITY, f32::min).max(0.0) as usize;
        let high = particles.iter().map(of).fold(0.0, f32::max) as usize;
        low..(high + 1).max(low)
    };
    if particles.is_empty() { (0..0, 0..0) } else { (range(|p| p.x), range(|p| p.y)) }
}

fn fill(image: &mut GrayImage, (columns, rows): Rectangle, value: u8) {
    for v in rows.start..rows.end.min(image.height()) {
        let right = columns.end.min(image.width());
        image.row_mut(v)[columns.start.min(right)..right].fill(value);
    }
}

fn draw_disc(mask: &mut Mask, [x, y]: [f32; 2]) {
    let (x, y) = (x.round() as i64, y.round() as i64);
    for dy in -FEATURE_RADIUS..=FEATURE_RADIUS {
        for dx in -FEATURE_RADIUS..=FEATURE_RADIUS {
            let inside = dx * dx + dy * dy <= FEATURE_RADIUS * FEATURE_RADIUS;
            if let (true, Ok(u), Ok(v)) = (inside, usize::try_from(x + dx), usize::try_from(y + dy)) {
                mask.set(u, v, true);
            }
        }
    }
}
