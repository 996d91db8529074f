//! The particle filter over motion evidence (paper, section 3.2, Eq. 2 to 5, algorithm 2 steps 0 to 4).
//!
//! Two equations cannot be used as printed:
//! * Eq. 3 takes the difference image at the particle itself out of the sum over its neighbours, and divides by `2σ` instead of
//!   `2σ²`. Read so, neighbours contribute nothing but a constant. We sum the difference image *at the neighbours*, weighted by
//!   a Gaussian of the distance `d` (Eq. 4): the image smoothed by that kernel, read at the particle.
//! * Eq. 5 lacks the inverse of Σ and the drift, and draws all particles from one Gaussian "of all previous particle points",
//!   which merges separate objects into one blob and forgets the velocities of Eq. 2. We move each particle by its own velocity
//!   and add Gaussian noise of fixed covariance.

use nalgebra::{Matrix4, Vector4};
use pfd_geometry::Image;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::config::ParticleConfig;

/// A particle: position (pixels) and velocity (pixels per second), Eq. 2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Particle {
    /// Column.
    pub x: f32,
    /// Row.
    pub y: f32,
    /// Column per second.
    pub vx: f32,
    /// Row per second.
    pub vy: f32,
}

/// A set of particles over an image.
#[derive(Clone, Debug)]
pub struct ParticleFilter {
    particles: Vec<Particle>,
    weights: Vec<f64>,
    spare: Vec<Particle>,
    size: (f32, f32),
    config: ParticleConfig,
    rng: Pcg64Mcg,
}

/// One particle of this many is drawn anew from the whole image in every frame, so that a new mover is found wherever it appears.
const SCOUT_EVERY: usize = 10;

impl ParticleFilter {
    /// Particles spread uniformly over an image of `width × height` pixels (algorithm 2, steps 0 and 1).
    pub fn new((width, height): (usize, usize), config: ParticleConfig, seed: u64) -> Self {
        let mut filter = Self {
            particles: vec![Particle::default(); config.count],
            weights: vec![1.0 / config.count.max(1) as f64; config.count],
            spare: Vec::with_capacity(config.count),
            size: (width as f32, height as f32),
            config,
            rng: Pcg64Mcg::seed_from_u64(seed),
        };
        filter.scatter();
        filter
    }

    /// The particles.
    pub fn particles(&self) -> &[Particle] {
        &self.particles
    }

    /// Spreads all particles uniformly over the image, at rest (step 1).
    pub fn scatter(&mut self) {
        for i in 0..self.particles.len() {
            self.particles[i] = self.scout();
        }
        self.weights.fill(1.0 / self.particles.len().max(1) as f64);
    }

    fn scout(&mut self) -> Particle {
        let (width, height) = self.size;
        let (x, y) = (self.rng.random::<f32>() * width, self.rng.random::<f32>() * height);
        Particle { x, y, vx: 0.0, vy: 0.0 }
    }

    /// Moves the particles by `dt` seconds (step 2, Eq. 5). What leaves the image is drawn anew: without evidence all would gather at its
    /// border.
    pub fn predict(&mut self, dt: f64) {
        let dt = dt as f32;
        let (position, velocity) = (self.config.position_sigma as f32, self.config.velocity_sigma as f32);
        let (width, height) = self.size;
        for i in 0..self.particles.len() {
            let [a, b] = gaussian_pair(&mut self.rng);
            let [c, d] = gaussian_pair(&mut self.rng);
            let p = &mut self.particles[i];
            p.x += p.vx * dt + position * a;
            p.y += p.vy * dt + position * b;
            p.vx += velocity * c;
            p.vy += velocity * d;
            if !((0.0..width).contains(&p.x) && (0.0..height).contains(&p.y)) {
                self.particles[i] = self.scout();
            }
        }
    }

    /// One step: move by `dt` seconds, weigh by `evidence`, resample.
    pub fn advance(&mut self, dt: f64, evidence: impl Fn(&Particle) -> f32) {
        self.predict(dt);
        self.weigh_by(evidence);
        self.resample();
    }

    /// Weighs the particles by evidence that was smoothed with the kernel of Eq. 3 (step 3), of the size of the image. Returns what
    /// [`Self::weigh_by`] does.
    pub fn weigh<T: Copy + Default + Into<f32>>(&mut self, smoothed: &Image<T>) -> f64 {
        let (width, height) = smoothed.size();
        self.weigh_by(|p| {
            let u = (p.x as usize).min(width.saturating_sub(1));
            let v = (p.y as usize).min(height.saturating_sub(1));
            smoothed.get(u, v).copied().unwrap_or_default().into()
        })
    }

    /// Weighs each particle by `evidence`; returns the mean evidence under the weighted particles.
    pub fn weigh_by(&mut self, evidence: impl Fn(&Particle) -> f32) -> f64 {
        let (mut sum, mut squares) = (0.0, 0.0);
        for (p, w) in self.particles.iter().zip(&mut self.weights) {
            *w = f64::from(evidence(p).max(0.0)) + MIN_WEIGHT;
            sum += *w;
            squares += *w * *w;
        }
        for w in &mut self.weights {
            *w /= sum;
        }
        squares / sum.max(MIN_WEIGHT)
    }

    /// Effective number of particles, `1 / Σ w²`.
    pub fn effective(&self) -> f64 {
        1.0 / self.weights.iter().map(|w| w * w).sum::<f64>().max(f64::MIN_POSITIVE)
    }

    /// Resamples when too few particles carry the weight (step 4): systematic resampling (Kitagawa 1996). Scouts are sent in any case.
    pub fn resample(&mut self) {
        if self.effective() < self.config.resample_below * self.particles.len() as f64 {
            self.draw_by_weight();
        }
        self.send_scouts();
    }

    fn draw_by_weight(&mut self) {
        let n = self.particles.len();
        let mut position = self.rng.random::<f64>() / n as f64;
        let mut cumulative = 0.0;
        self.spare.clear();
        for (p, w) in self.particles.iter().zip(&self.weights) {
            cumulative += w;
            while position < cumulative && self.spare.len() < n {
                self.spare.push(*p);
                position += 1.0 / n as f64;
            }
        }
        self.spare.resize(n, self.particles[n - 1]);
        std::mem::swap(&mut self.particles, &mut self.spare);
        self.weights.fill(1.0 / n as f64);
    }

    fn send_scouts(&mut self) {
        let first = self.rng.random_range(0..SCOUT_EVERY);
        for i in (first..self.particles.len()).step_by(SCOUT_EVERY) {
            self.particles[i] = self.scout();
        }
    }
}

/// Keeps the weights positive where there is no evidence at all.
const MIN_WEIGHT: f64 = 1e-9;

/// Two independent standard normal numbers (Box and Muller 1958).
fn gaussian_pair(rng: &mut Pcg64Mcg) -> [f32; 2] {
    let radius = (-2.0 * (1.0 - rng.random::<f32>()).ln()).sqrt();
    let (sin, cos) = (std::f32::consts::TAU * rng.random::<f32>()).sin_cos();
    [radius * cos, radius * sin]
}

/// Mean and covariance of particle states; zero for no particles.
pub fn statistics(particles: &[Particle]) -> (Vector4<f64>, Matrix4<f64>) {
    let state = |p: &Particle| Vector4::new(p.x, p.y, p.vx, p.vy).map(f64::from);
    let count = particles.len().max(1) as f64;
    let mean = particles.iter().map(state).sum::<Vector4<f64>>() / count;
    let spread = particles.iter().map(|p| state(p) - mean);
    (mean, spread.map(|d| d * d.transpose()).sum::<Matrix4<f64>>() / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bright disc of radius 12 pixels at `(x, y)`.
    fn disc(x: f32, y: f32) -> Image<f32> {
        let mut image = Image::filled(200, 150, 0.0);
        for v in 0..150 {
            for u in 0..200 {
                if (u as f32 - x).hypot(v as f32 - y) < 12.0 {
                    image[(u, v)] = 1.0;
                }
            }
        }
        image
    }

    #[test]
    fn particles_follow_a_moving_disc() {
        let mut filter = ParticleFilter::new((200, 150), ParticleConfig::default(), 3);
        for frame in 0..30 {
            filter.predict(1.0 / 30.0);
            filter.weigh(&disc(40.0 + 4.0 * frame as f32, 70.0));
            filter.resample();
        }
        let near = |p: &&Particle| (p.x - 156.0).hypot(p.y - 70.0) < 25.0;
        let near: Vec<Particle> = filter.particles().iter().filter(near).copied().collect();
        let share = near.len() as f64 / 1000.0;
        assert!(share > 0.75, "{share}");
        let (mean, covariance) = statistics(&near);
        assert!((mean.x - 156.0).abs() < 5.0 && (mean.y - 70.0).abs() < 5.0, "{mean}");
        assert!(mean[2] > 50.0 && mean[2] < 190.0, "120 pixels per second, got {}", mean[2]);
        assert!(covariance[(0, 0)] > 1.0 && covariance[(0, 0)] < 250.0);
    }

    #[test]
    fn uniform_particles_cover_the_image() {
        let filter = ParticleFilter::new((200, 150), ParticleConfig::default(), 1);
        let (mean, covariance) = statistics(filter.particles());
        // A uniform variable on [0, L] has mean L/2 and variance L²/12.
        assert!((mean.x - 100.0).abs() < 6.0 && (mean.y - 75.0).abs() < 5.0);
        assert!((covariance[(0, 0)] / (200.0 * 200.0 / 12.0) - 1.0).abs() < 0.15);
        assert!((filter.effective() - 1000.0).abs() < 1e-6);
    }

    #[test]
    fn particles_stay_spread_where_there_is_no_evidence() {
        let mut filter = ParticleFilter::new((200, 150), ParticleConfig::default(), 7);
        for _ in 0..300 {
            filter.advance(1.0 / 30.0, |_| 0.0);
        }
        let share = |holds: fn(&&Particle) -> bool| filter.particles().iter().filter(holds).count() as f64 / 1000.0;
        let centre = share(|p| (50.0..150.0).contains(&p.x) && (37.5..112.5).contains(&p.y));
        let border = share(|p| p.x < 5.0 || p.x >= 195.0 || p.y < 5.0 || p.y >= 145.0);
        // Of a uniform distribution a quarter and 11 % lie there.
        assert!((0.2..0.4).contains(&centre) && border < 0.12, "{centre} {border}");
    }

    #[test]
    fn the_same_seed_gives_the_same_particles() {
        let run = || {
            let mut filter = ParticleFilter::new((200, 150), ParticleConfig::default(), 5);
            for _ in 0..3 {
                filter.predict(0.03);
                filter.weigh(&disc(50.0, 50.0));
                filter.resample();
            }
            filter.particles().to_vec()
        };
        assert_eq!(run(), run());
    }
}
