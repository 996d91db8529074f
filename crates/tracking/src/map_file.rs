//! Maps in files.
//!
//! A file is, in this order: the eight bytes `PFDSLAM\0`; the version of the format (u32, little endian); the CRC-32 of the
//! payload (u32, little endian); the payload: `MapRecord` in the postcard encoding (<https://postcard.jamesmunns.com>).

use std::io::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Point2, Point3, Quaternion, Translation3, UnitQuaternion, Vector6};
use pfd_geometry::{Camera, Pose, Stamp, pose};
use pfd_vision::features::{Descriptor, Feature};
use pfd_vision::patch::Patch;
use serde::{Deserialize, Serialize};
use slotmap::SecondaryMap;

use crate::config::TrackingConfig;
use crate::image_features::ImageFeatures;
use crate::map::{Counts, Keyframe, KeyframeId, Map, Observation, UNIT_TOLERANCE};
use crate::residual::Measurement;
use crate::rolling_shutter::Shutter;

const MAGIC: &[u8; 8] = b"PFDSLAM\0";
/// Raised whenever [`MapRecord`], the descriptor or its pattern change.
const VERSION: u32 = 4;
const HEADER: usize = MAGIC.len() + 2 * size_of::<u32>();
/// A larger file (bytes) is refused before it is read.
const MAX_FILE_SIZE: u64 = 4 << 30;

/// Why a map could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum MapFileError {
    /// The file system refused.
    #[error("{}: {error}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What it said.
        error: std::io::Error,
    },
    /// Not a map.
    #[error("{}: not a map of pfd-slam", .0.display())]
    NotAMap(PathBuf),
    /// A map in another format.
    #[error("{}: map format {found}, this program reads {VERSION}: record the map again", path.display())]
    Version {
        /// Which file.
        path: PathBuf,
        /// Version in the file.
        found: u32,
    },
    /// The file was cut off or changed.
    #[error("{}: the map is damaged ({what})", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        what: &'static str,
    },
    /// The map was made with another camera.
    #[error("{}: the map was recorded with another camera: its intrinsics differ from the present ones", .0.display())]
    OtherCamera(PathBuf),
    /// The map was made with another image pyramid.
    #[error(
        "{}: the map was made with tracking.features.scale={found}, and the parameter is {wanted}: set it to {found}, or record the map again",
        path.display()
    )]
    OtherPyramid {
        /// Which file.
        path: PathBuf,
        /// With which it was made.
        found: f64,
        /// With which this program works.
        wanted: f64,
    },
}

/// A part of a map, copied, so that it can be written while the map grows.
#[derive(Clone, Debug)]
pub struct MapSnapshot {
    pub(crate) map: Map,
    /// Its keyframes in the order of their creation.
    pub(crate) order: Vec<KeyframeId>,
    pub(crate) maker: Maker,
}

/// What a map has in common with the program that made it, and with each that can use it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Maker {
    camera: CameraRecord,
    /// Ratio of the sizes of two pyramid levels: corners and their surroundings are stored by level.
    scale: f64,
}

#[derive(Serialize, Deserialize)]
struct MapRecord {
    maker: Maker,
    keyframes: Vec<KeyframeRecord>,
    points: Vec<PointRecord>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct CameraRecord {
    size: (u32, u32),
    intrinsics: [f64; 4],
    distortion: [f64; 5],
}

#[derive(Serialize, Deserialize)]
struct KeyframeRecord {
    stamp: i64,
    frame_index: u64,
    /// Of `T_camera_world`: x y z, then the quaternion x y z w.
    translation: [f64; 3],
    rotation: [f64; 4],
    /// Of [`Shutter`].
    velocity: [f64; 6],
    readout: f64,
    features: Vec<FeatureRecord>,
}

#[derive(Serialize, Deserialize)]
struct FeatureRecord {
    position: (f32, f32),
    angle: f32,
    level: u8,
    response: f32,
    descriptor: [u64; 4],
    sigma: f64,
    depth: Option<(f64, f64)>,
    color: [u8; 3],
    /// Of features that show a map point.
    patch: Option<PatchRecord>,
}

#[derive(Serialize, Deserialize)]
struct PatchRecord {
    centre: [i32; 2],
    pixels: Vec<u8>,
}

#[derive(Serialize, Deserialize)]
struct PointRecord {
    position: [f64; 3],
    visible: u32,
    found: u32,
    contradicted: u32,
    /// Keyframe (index in `keyframes`) and feature.
    observations: Vec<(u32, u32)>,
}

impl MapSnapshot {
    /// Writes the map to `path`, first to a file beside it, so that an interrupted write leaves the old map.
    ///
    /// # Errors
    /// [`MapFileError::Io`].
    pub fn save(&self, path: &Path) -> Result<(), MapFileError> {
        let io = |error| MapFileError::Io { path: path.to_owned(), error };
        let payload = postcard::to_stdvec(&record(self)).map_err(|e| io(std::io::Error::other(e)))?;
        let mut bytes = Vec::with_capacity(HEADER + payload.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&crc32fast::hash(&payload).to_le_bytes());
        bytes.extend_from_slice(&payload);
        let partial = path.with_extension("partial");
        // On the disk before it takes the place of the old one: else a power cut may leave neither.
        let write = || {
            let mut file = std::fs::File::create(&partial)?;
            file.write_all(&bytes)?;
            file.sync_all()?;
            std::fs::rename(&partial, path)
        };
        write().map_err(io)
    }
}

/// Whether a file is a map that can be read; with which camera it was recorded is not asked.
///
/// # Errors
/// [`MapFileError`] when the file is no map, of another version, or damaged.
pub fn check(path: &Path) -> Result<(), MapFileError> {
    read(path).map(drop)
}

/// Reads a map that was recorded with `camera`; keyframes in the order of their creation.
///
/// # Errors
/// [`MapFileError`] when the file is no map, of another version, damaged, of another camera, or made with other features.
pub fn load(path: &Path, camera: &Camera, config: &TrackingConfig) -> Result<(Map, Vec<KeyframeId>), MapFileError> {
    let record = read(path)?;
    let (made, wanted) = (&record.maker, Maker::new(camera, config));
    if made.camera != wanted.camera {
        return Err(MapFileError::OtherCamera(path.to_owned()));
    }
    if made.scale != wanted.scale {
        return Err(MapFileError::OtherPyramid { path: path.to_owned(), found: made.scale, wanted: wanted.scale });
    }
    restore(&record, camera).ok_or_else(|| MapFileError::Damaged { path: path.to_owned(), what: "inconsistent" })
}

fn read(path: &Path) -> Result<MapRecord, MapFileError> {
    let io = |error| MapFileError::Io { path: path.to_owned(), error };
    let damaged = |what| MapFileError::Damaged { path: path.to_owned(), what };
    if std::fs::metadata(path).map_err(io)?.len() > MAX_FILE_SIZE {
        return Err(damaged("larger than any map"));
    }
    let bytes = std::fs::read(path).map_err(io)?;
    postcard::from_bytes(payload(path, &bytes)?).map_err(|_| damaged("not decodable"))
}

fn payload<'a>(path: &Path, bytes: &'a [u8]) -> Result<&'a [u8], MapFileError> {
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| MapFileError::NotAMap(path.to_owned()))?;
    let damaged = |what| MapFileError::Damaged { path: path.to_owned(), what };
    let (version, rest) = rest.split_first_chunk().ok_or_else(|| damaged("cut off"))?;
    let found = u32::from_le_bytes(*version);
    if found != VERSION {
        return Err(MapFileError::Version { path: path.to_owned(), found });
    }
    let (checksum, payload) = rest.split_first_chunk().ok_or_else(|| damaged("cut off"))?;
    if crc32fast::hash(payload) == u32::from_le_bytes(*checksum) { Ok(payload) } else { Err(damaged("checksum")) }
}

impl Maker {
    pub(crate) fn new(camera: &Camera, config: &TrackingConfig) -> Self {
        let camera = CameraRecord {
            size: (camera.width as u32, camera.height as u32),
            intrinsics: [camera.fx, camera.fy, camera.cx, camera.cy],
            distortion: camera.distortion.0,
        };
        Self { camera, scale: config.features.scale }
    }
}

fn record(MapSnapshot { map, order, maker }: &MapSnapshot) -> MapRecord {
    let index_of: SecondaryMap<KeyframeId, u32> = order.iter().copied().zip(0..).collect();
    let observe = |seen: &Observation| Some((*index_of.get(seen.keyframe)?, seen.feature as u32));
    let points = map.points().map(|(_, point)| PointRecord {
        position: point.position.coords.into(),
        visible: point.counts.visible,
        found: point.counts.found,
        contradicted: point.counts.contradicted,
        observations: point.observations().iter().filter_map(observe).collect(),
    });
    MapRecord {
        maker: maker.clone(),
        keyframes: order.iter().filter_map(|id| map.keyframe(*id)).map(keyframe_record).collect(),
        points: points.collect(),
    }
}

fn keyframe_record(keyframe: &Keyframe) -> KeyframeRecord {
    let feature = |i: usize| {
        let (feature, measured) = (keyframe.features.feature(i), keyframe.features.raw(i));
        let shows_point = keyframe.points()[i].is_some();
        let patch = keyframe.features.patch(i).filter(|_| shows_point);
        FeatureRecord {
            position: (measured.pixel.x as f32, measured.pixel.y as f32),
            angle: feature.angle,
            level: feature.level,
            response: feature.response,
            descriptor: feature.descriptor.0,
            sigma: measured.sigma,
            depth: measured.depth,
            color: keyframe.features.color(i),
            patch: patch.map(|p| PatchRecord { centre: p.centre(), pixels: p.pixels().to_vec() }),
        }
    };
    KeyframeRecord {
        stamp: keyframe.stamp.as_nanos(),
        frame_index: keyframe.frame_index as u64,
        translation: keyframe.T_camera_world.translation.vector.into(),
        rotation: keyframe.T_camera_world.rotation.coords.into(),
        velocity: keyframe.features.shutter().velocity.into(),
        readout: keyframe.features.shutter().readout,
        features: (0..keyframe.features.len()).map(feature).collect(),
    }
}

/// `None` when indices or numbers make no sense.
fn restore(record: &MapRecord, camera: &Camera) -> Option<(Map, Vec<KeyframeId>)> {
    let mut map = Map::default();
    let keyframes: Option<Vec<_>> =
        record.keyframes.iter().map(|k| Some(map.add_keyframe(restore_keyframe(k, camera)?))).collect();
    let keyframes = keyframes?;
    for point in &record.points {
        let observe =
            |&(k, f): &(u32, u32)| Some(Observation { keyframe: *keyframes.get(k as usize)?, feature: f as usize });
        let observations: Vec<_> = point.observations.iter().map(observe).collect::<Option<_>>()?;
        let (first, others) = observations.split_first()?;
        let id = map.add_point(Point3::from(point.position), *first)?;
        for seen in others {
            map.add_observation(id, *seen).then_some(())?;
        }
        map.point_mut(id)?.counts =
            Counts { visible: point.visible, found: point.found, contradicted: point.contradicted };
    }
    Some((map, keyframes))
}

fn restore_keyframe(record: &KeyframeRecord, camera: &Camera) -> Option<Keyframe> {
    let [x, y, z, w] = record.rotation;
    let quaternion = Quaternion::new(w, x, y, z);
    let rotation =
        ((quaternion.norm() - 1.0).abs() < UNIT_TOLERANCE).then(|| UnitQuaternion::new_unchecked(quaternion))?;
    let restored: Pose = Isometry3::from_parts(Translation3::from(record.translation), rotation);
    let velocity = Vector6::from(record.velocity);
    let moves = velocity.iter().all(|x| x.is_finite()) && record.readout.is_finite();
    let frame_index = u32::try_from(record.frame_index).ok()? as usize;
    if !pose::is_finite(&restored) || !moves || !record.features.iter().all(is_plausible) {
        return None;
    }
    let feature = |f: &FeatureRecord| Feature {
        u: f.position.0,
        v: f.position.1,
        angle: f.angle,
        level: f.level,
        response: f.response,
        descriptor: Descriptor(f.descriptor),
    };
    let measurement = |f: &FeatureRecord| Measurement {
        pixel: Point2::new(f64::from(f.position.0), f64::from(f.position.1)),
        sigma: f.sigma,
        depth: f.depth,
    };
    let patch = |f: &FeatureRecord| f.patch.as_ref().map(|p| Patch::from_parts(p.centre, &p.pixels));
    let patches = record.features.iter().map(|f| patch(f).map_or(Some(None), |p| p.map(Some)));
    let mut features = ImageFeatures::from_parts(
        (camera.width, camera.height),
        record.features.iter().map(feature).collect(),
        record.features.iter().map(measurement).collect(),
        record.features.iter().map(|f| f.color).collect(),
    )
    .with_patches(patches.collect::<Option<_>>()?);
    features.set_shutter(camera, Shutter { velocity, readout: record.readout });
    // Not renormalised, so that a map that is loaded and saved again stays the same to the byte.
    let mut keyframe = Keyframe::new(Stamp::from_nanos(record.stamp), frame_index, restored, features);
    keyframe.T_camera_world = restored;
    Some(keyframe)
}

fn is_plausible(f: &FeatureRecord) -> bool {
    let inside = f.position.0 >= 0.0 && f.position.1 >= 0.0;
    let depth = f.depth.is_none_or(|(z, sigma)| z.is_finite() && z > 0.0 && sigma.is_finite() && sigma > 0.0);
    inside && depth && f.position.0.is_finite() && f.position.1.is_finite() && f.sigma.is_finite() && f.sigma > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Distortion;
    use proptest::prelude::*;

    fn test_camera() -> Camera {
        Camera::new((640, 480), [520.0, 520.0, 320.0, 240.0], Distortion::default()).unwrap()
    }

    fn snapshot() -> MapSnapshot {
        let feature = |i: u16| Feature {
            u: f32::from(i),
            v: 3.0,
            angle: 0.1,
            level: 1,
            response: 9.0,
            descriptor: Descriptor([u64::from(i); 4]),
        };
        let measured = |i: u16| Measurement {
            pixel: Point2::new(f64::from(i), 3.0),
            sigma: 1.2,
            depth: i.is_multiple_of(2).then_some((1.5, 0.02)),
        };
        let shutter = Shutter { velocity: nalgebra::Vector6::new(0.1, -0.2, 0.0, 0.3, 0.0, 0.1), readout: 0.02 };
        let patch = |i: i32| Patch::cut(&[7; 100 * 100], 100, [20 + i, 30]);
        let features = || {
            let mut features = ImageFeatures::from_parts(
                (640, 480),
                (0..20).map(feature).collect(),
                (0..20).map(measured).collect(),
                (0..20).map(|i| [i as u8; 3]).collect(),
            )
            .with_patches((0..20).map(patch).collect());
            features.set_shutter(&test_camera(), shutter);
            features
        };
        let mut map = Map::default();
        let pose = |i: f64| pose::exp(&nalgebra::Vector6::new(0.1 * i, 0.2 * i, 0.3, 0.1 * i, -0.2, 0.05 * i));
        let keyframe = |i: u8| Keyframe::new(Stamp::from_nanos(i.into()), i.into(), pose(i.into()), features());
        let ids: Vec<_> = (0..9).map(|i| map.add_keyframe(keyframe(i))).collect();
        for feature in 0..15 {
            let position = Point3::new(0.1, 0.2, 1.0 + feature as f64);
            let id = map.add_point(position, Observation { keyframe: ids[0], feature }).unwrap();
            map.add_observation(id, Observation { keyframe: ids[1], feature: feature + 1 });
        }
        MapSnapshot { map, order: ids, maker: Maker::new(&test_camera(), &TrackingConfig::default()) }
    }

    #[test]
    fn a_map_survives_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let (path, again) = (folder.path().join("a.map"), folder.path().join("b.map"));
        let camera = test_camera();
        let (config, whole) = (TrackingConfig::default(), snapshot());
        whole.save(&path).unwrap();
        let (map, order) = (&whole.map, &whole.order);
        let (restored, restored_order) = load(&path, &camera, &config).unwrap();
        assert_eq!((restored.keyframe_count(), restored.point_count()), (9, 15));
        assert_eq!(restored.check(), Ok(()));
        let view = |map: &Map, order: &[KeyframeId]| map.keyframe(order[1]).unwrap().features.clone();
        let (before, after) = (view(map, order), view(&restored, &restored_order));
        assert_eq!((after.shutter(), after.patch(3)), (before.shutter(), before.patch(3)));
        assert!((after.measurement(3).pixel - before.measurement(3).pixel).norm() < 1e-3);
        assert_eq!(after.patch(19), None, "that feature shows no point");
        let maker = Maker::new(&camera, &config);
        MapSnapshot { map: restored, order: restored_order, maker }.save(&again).unwrap();
        assert!(std::fs::read(&path).unwrap() == std::fs::read(&again).unwrap());
        let other = Camera { fx: 500.0, ..camera };
        assert!(matches!(load(&path, &other, &config), Err(MapFileError::OtherCamera(_))));
        let mut finer = config;
        finer.features.scale = 1.1;
        assert!(load(&path, &camera, &finer).unwrap_err().to_string().contains("features.scale=1.2"));
    }

    #[test]
    fn older_and_foreign_files_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("old.map");
        let camera = test_camera();
        std::fs::write(&path, [MAGIC.as_slice(), &[0; 8]].concat()).unwrap();
        let load = || load(&path, &camera, &TrackingConfig::default());
        assert!(matches!(load(), Err(MapFileError::Version { found: 0, .. })));
        std::fs::write(&path, b"# TUM trajectory").unwrap();
        assert!(load().unwrap_err().to_string().contains("old.map: not a map"));
    }

    proptest! {
        #[test]
        fn damage_is_refused(at in any::<prop::sample::Index>(), flip in 1..=255_u8, keep in any::<prop::sample::Index>()) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.map");
            let camera = test_camera();
            snapshot().save(&path).unwrap();
            let whole = std::fs::read(&path).unwrap();
            let mut changed = whole.clone();
            changed[at.index(whole.len())] ^= flip;
            for damaged in [&changed[..], &whole[..keep.index(whole.len())]] {
                std::fs::write(&path, damaged).unwrap();
                prop_assert!(load(&path, &camera, &TrackingConfig::default()).is_err());
            }
        }

        /// The checksum does not guard against a forged file: bytes of a record are changed, and what still is one is restored.
        #[test]
        fn forged_records_are_refused_or_harmless(
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        ) {
            let camera = test_camera();
            let mut payload = postcard::to_stdvec(&record(&snapshot())).unwrap();
            for (at, value) in changes {
                let at = at.index(payload.len());
                payload[at] = value;
            }
            if let Ok(record) = postcard::from_bytes::<MapRecord>(&payload)
                && let Some((map, _)) = restore(&record, &camera) {
                prop_assert_eq!(map.check(), Ok(()));
            }
        }

        /// The checksum does not guard against a forged file: decode arbitrary payloads as well.
        #[test]
        fn forged_payloads_do_not_panic(payload in prop::collection::vec(any::<u8>(), 0..300)) {
            if let Ok(record) = postcard::from_bytes::<MapRecord>(&payload)
                && let Some((map, _)) = restore(&record, &test_camera()) {
                prop_assert_eq!(map.check(), Ok(()));
            }
        }
    }
}
