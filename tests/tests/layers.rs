//! The architecture of ARCHITECTURE.md, held against the manifests.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, MetadataCommand};
use pfd_tests::repository;

/// Layer of every crate. A crate depends on lower layers only.
const LAYERS: [(&str, u8); 13] = [
    ("pfd-geometry", 0),
    ("pfd-parameters", 0),
    ("pfd-vision", 1),
    ("pfd-optimization", 1),
    ("pfd-dataset", 1),
    ("pfd-evaluation", 1),
    ("pfd-ros", 1),
    ("pfd-segmentation", 2),
    ("pfd-tracking", 2),
    ("pfd-pipeline", 3),
    ("pfd-report", 3),
    ("pfd-slam-nodes", 4),
    ("pfd-slam", 4),
];

/// Crates that only one of ours may use.
const EXCLUSIVE: [(&str, &str); 4] =
    [("opencv", "pfd-vision"), ("faer", "pfd-optimization"), ("ros2-client", "pfd-ros"), ("rustdds", "pfd-ros")];

/// What each crate of the workspace uses when it runs (not what its tests use).
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let metadata = MetadataCommand::new()
        .manifest_path(repository().join("Cargo.toml"))
        .no_deps()
        .other_options(["--offline".to_owned()])
        .exec()
        .unwrap();
    let used = |package: &cargo_metadata::Package| {
        let normal = package.dependencies.iter().filter(|d| d.kind == DependencyKind::Normal);
        normal.map(|d| d.name.clone()).collect()
    };
    metadata.workspace_packages().into_iter().map(|p| (p.name.to_string(), used(p))).collect()
}

fn layer(name: &str) -> Option<u8> {
    LAYERS.iter().find(|(n, _)| *n == name).map(|(_, layer)| *layer)
}

#[test]
fn every_crate_has_a_layer() {
    for name in dependencies().keys().filter(|name| *name != "pfd-tests") {
        assert!(layer(name).is_some(), "{name} has no layer: add it here and to ARCHITECTURE.md");
    }
}

#[test]
fn crates_use_lower_layers_only() {
    for (name, used) in dependencies().iter().filter(|(name, _)| *name != "pfd-tests") {
        for other in used.iter().filter(|other| layer(other).is_some()) {
            assert!(layer(other) < layer(name), "{name} uses {other}, which is not in a lower layer");
        }
    }
}

#[test]
fn heavy_libraries_stay_behind_one_crate() {
    for (name, used) in &dependencies() {
        for (library, owner) in EXCLUSIVE.iter().filter(|(library, _)| used.contains(*library)) {
            assert_eq!(name, owner, "{library} belongs behind {owner}");
        }
    }
}

#[test]
fn algorithms_know_no_middleware() {
    let all = dependencies();
    for name in ["pfd-segmentation", "pfd-tracking", "pfd-pipeline"] {
        for middleware in ["pfd-ros", "ros2-client", "rustdds", "tokio"] {
            assert!(!all[name].contains(middleware), "{name} uses {middleware}");
        }
    }
}
