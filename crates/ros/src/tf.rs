//! Transforms between frames that do not move (`/tf_static`).

use std::collections::{BTreeMap, VecDeque};

use pfd_geometry::Pose;

/// Frames kept; a tree with more is not a robot's.
const MAX_FRAMES: usize = 4096;

/// The static transforms heard so far.
#[derive(Clone, Debug, Default)]
pub struct StaticTransforms {
    /// Child → parent, `T_parent_child`.
    parents: BTreeMap<String, (String, Pose)>,
}

impl StaticTransforms {
    /// Takes over `T_parent_child`; a frame that moves to another parent leaves the old one.
    pub fn insert(&mut self, parent: &str, child: &str, pose: Pose) {
        if parent == child || !pfd_geometry::pose::is_finite(&pose) || self.parents.len() >= MAX_FRAMES {
            return;
        }
        self.parents.insert(normal(child), (normal(parent), pose));
    }

    /// `T_target_source`, if static transforms connect the two.
    pub fn lookup(&self, target: &str, source: &str) -> Option<Pose> {
        let (target, source) = (normal(target), normal(source));
        let mut poses = BTreeMap::from([(target.clone(), Pose::identity())]);
        let mut open = VecDeque::from([target]);
        while let Some(frame) = open.pop_front() {
            let pose = *poses.get(&frame)?;
            if frame == source {
                return Some(pose);
            }
            for (next, step) in self.neighbours(&frame) {
                if !poses.contains_key(&next) {
                    poses.insert(next.clone(), pose * step);
                    open.push_back(next);
                }
            }
        }
        None
    }

    /// The frame at the top of the tree above `source`, with `T_root_source`; `None` when there is none above.
    pub fn root(&self, source: &str) -> Option<(String, Pose)> {
        let mut frame = normal(source);
        let mut pose = Pose::identity();
        // A loop, which no tree has, ends after as many steps as there are frames.
        for _ in 0..self.parents.len() {
            let Some((parent, step)) = self.parents.get(&frame) else { break };
            pose = step * pose;
            frame.clone_from(parent);
        }
        (frame != normal(source)).then_some((frame, pose))
    }

    /// Frames one step away, with `T_frame_next`.
    fn neighbours(&self, frame: &str) -> Vec<(String, Pose)> {
        let up = self.parents.get(frame).map(|(parent, pose)| (parent.clone(), pose.inverse()));
        let down = self.parents.iter().filter(|(_, (parent, _))| parent == frame);
        up.into_iter().chain(down.map(|(child, (_, pose))| (child.clone(), *pose))).collect()
    }
}

/// Old names begin with a slash.
fn normal(frame: &str) -> String {
    frame.trim_start_matches('/').to_owned()
}

/// `T_map_world` for a world that is the first camera's optical frame (x right, y down, z forward): the map has x forward,
/// y left, z up (REP-103).
pub fn upright_map() -> Pose {
    use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Pose::from_parts(Translation3::identity(), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};

    fn shift(x: f64) -> Pose {
        Pose::translation(x, 0.0, 0.0)
    }

    #[test]
    fn chains_up_and_down_the_tree() {
        let mut tree = StaticTransforms::default();
        tree.insert("base_link", "camera_link", shift(1.0));
        tree.insert("camera_link", "optical", shift(0.5) * upright_map());
        tree.insert("/base_link", "laser", shift(3.0));
        let pose = tree.lookup("laser", "optical").unwrap();
        assert!((pose.translation.vector - Vector3::new(-1.5, 0.0, 0.0)).norm() < 1e-12);
        let back = tree.lookup("optical", "laser").unwrap();
        assert!((pose * back).translation.vector.norm() < 1e-12);
        assert_eq!(tree.lookup("base_link", "elsewhere"), None);
        assert_eq!(tree.lookup("a", "a"), Some(Pose::identity()));
        let (root, pose) = tree.root("optical").unwrap();
        assert_eq!((root.as_str(), tree.root("base_link")), ("base_link", None));
        assert!((pose.translation.vector.x - 1.5).abs() < 1e-12);
    }

    #[test]
    fn loops_and_nonsense_do_no_harm() {
        let mut tree = StaticTransforms::default();
        tree.insert("a", "b", shift(1.0));
        tree.insert("b", "a", shift(1.0));
        tree.insert("a", "a", shift(1.0));
        tree.insert("a", "c", shift(f64::NAN));
        assert_eq!(tree.lookup("a", "c"), None);
        assert!(tree.lookup("a", "b").is_some());
        assert_eq!(tree.root("b"), None, "after a full turn");
    }

    #[test]
    fn the_map_is_upright() {
        let forward = upright_map() * Point3::new(0.0, 0.0, 1.0);
        let up = upright_map() * Point3::new(0.0, -1.0, 0.0);
        assert!((forward - Point3::new(1.0, 0.0, 0.0)).norm() < 1e-12);
        assert!((up - Point3::new(0.0, 0.0, 1.0)).norm() < 1e-12);
    }
}
