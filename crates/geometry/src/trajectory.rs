//! Trajectories as text: lines `stamp tx ty tz qx qy qz qw`, the format of the TUM RGB-D benchmark.

use std::fmt::Write;

use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use crate::{Pose, Stamp, StampedPose};

/// A line that is not `stamp tx ty tz qx qy qz qw`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {reason}")]
pub struct TrajectoryError {
    /// Line number, from 1.
    pub line: usize,
    /// What is wrong with it.
    pub reason: String,
}

/// A quaternion whose length differs more than this from 1 is no rotation but a mistake in the file.
const MAX_NORM_ERROR: f64 = 0.05;

/// Reads a trajectory; empty lines and lines that start with `#` are skipped. Equal stamps are accepted: the benchmark's motion
/// capture has some.
///
/// # Errors
/// [`TrajectoryError`] for a line with too few numbers, numbers that are not finite, a quaternion that is no rotation, or a
/// stamp that is earlier than the one before.
pub fn parse(text: &str) -> Result<Vec<StampedPose>, TrajectoryError> {
    let mut poses: Vec<StampedPose> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let fail = |reason: String| TrajectoryError { line: index + 1, reason };
        let pose = parse_line(line).map_err(fail)?;
        if let Some(last) = poses.last().filter(|last| last.stamp > pose.stamp) {
            return Err(fail(format!("stamp {} is earlier than the one before, {}", pose.stamp, last.stamp)));
        }
        poses.push(pose);
    }
    Ok(poses)
}

/// The text of a trajectory.
pub fn to_text(poses: &[StampedPose]) -> String {
    let mut text = String::new();
    for StampedPose { stamp, pose } in poses {
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{stamp} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    }
    text
}

fn parse_line(line: &str) -> Result<StampedPose, String> {
    let mut fields = line.split_whitespace();
    let stamp: Stamp = fields.next().unwrap_or_default().parse().map_err(|e| format!("{e}"))?;
    let mut numbers = [0.0; 7];
    for (number, name) in numbers.iter_mut().zip(["tx", "ty", "tz", "qx", "qy", "qz", "qw"]) {
        let field = fields.next().ok_or_else(|| format!("{name} is missing: `stamp tx ty tz qx qy qz qw` expected"))?;
        *number = field
            .parse()
            .ok()
            .filter(|x: &f64| x.is_finite())
            .ok_or_else(|| format!("{name} `{field}` is not a finite number"))?;
    }
    let [x, y, z, qx, qy, qz, qw] = numbers;
    let rotation = Quaternion::new(qw, qx, qy, qz);
    if (rotation.norm() - 1.0).abs() > MAX_NORM_ERROR {
        return Err(format!("the quaternion has length {}, a rotation has length 1", rotation.norm()));
    }
    let pose = Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(rotation));
    Ok(StampedPose { stamp, pose })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reads_comments_and_poses() {
        let text = "# ground truth\n\n1305031098.6659 1.3563 0.6305 1.6380 0.6132 0.5962 -0.3311 -0.3986\n";
        let poses = parse(text).unwrap();
        assert_eq!(poses.len(), 1);
        assert_eq!(poses[0].stamp.to_string(), "1305031098.665900");
        assert!((poses[0].pose.translation.vector.z - 1.638).abs() < 1e-12);
    }

    #[test]
    fn names_line_and_reason() {
        let good = "1.0 0 0 0 0 0 0 1\n";
        for (bad, reason) in [
            ("x 0 0 0 0 0 0 1", "not a time stamp"),
            ("2.0 0 0 0 0 0 0", "qw is missing"),
            ("2.0 0 nan 0 0 0 0 1", "ty `nan`"),
            ("2.0 0 0 0 0 0 0 0", "length 0"),
            ("0.9 0 0 0 0 0 0 1", "earlier"),
        ] {
            let error = parse(&format!("{good}{bad}\n")).unwrap_err();
            assert_eq!(error.line, 2);
            assert!(error.reason.contains(reason), "{bad}: {error}");
        }
    }

    #[test]
    fn equal_stamps_are_kept() {
        assert_eq!(parse("1.0 1 0 0 0 0 0 1\n1.0 2 0 0 0 0 0 1\n").unwrap().len(), 2);
    }

    proptest! {
        #[test]
        fn any_text_parses_or_is_refused(text in "([0-9e.# \n-]{0,20}){0,12}") {
            let _ = parse(&text);
        }

        #[test]
        fn written_poses_are_read_back(x in -9.0..9.0_f64, angle in -3.0..3.0_f64, nanos in 0..i64::MAX) {
            let pose = Pose::new(nalgebra::Vector3::new(x, 0.0, -x), nalgebra::Vector3::new(0.1, angle, 0.0));
            let written = StampedPose { stamp: Stamp::from_nanos(nanos), pose };
            let read = parse(&to_text(&[written])).unwrap()[0];
            prop_assert_eq!(read.stamp, written.stamp);
            prop_assert!(crate::pose::log(&(read.pose.inverse() * pose)).norm() < 1e-8);
        }
    }
}
