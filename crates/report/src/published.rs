//! Published figures of other systems, for sequences known by name.

/// The eight sequences with people of the TUM RGB-D benchmark, in the order of the columns below.
const DYNAMIC: [&str; 8] = [
    "sitting_static",
    "sitting_xyz",
    "sitting_rpy",
    "sitting_half",
    "walking_static",
    "walking_xyz",
    "walking_rpy",
    "walking_half",
];

/// One metric of one system over [`DYNAMIC`]; `None` where nothing was published or tracking failed.
struct Row {
    system: &'static str,
    source: &'static str,
    values: [Option<f64>; 8],
}

/// Which error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// RMSE of the absolute error, m.
    Ate,
    /// RMSE of the relative error, m/s.
    RpeTranslation,
    /// RMSE of the relative error, deg/s.
    RpeRotation,
}

/// A published figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Published {
    /// Name of the system.
    pub system: &'static str,
    /// Where it was published.
    pub source: &'static str,
    /// RMSE.
    pub value: f64,
}

/// Figures of other systems for a sequence.
pub fn of(sequence: &str, metric: Metric) -> Vec<Published> {
    let rows: &[Row] = match metric {
        Metric::Ate => &ATE,
        Metric::RpeTranslation => &RPE_TRANSLATION,
        Metric::RpeRotation => &RPE_ROTATION,
    };
    let on_same_frames = SAME_FRAMES.iter().filter(|(name, _)| metric == Metric::Ate && *name == sequence);
    let column = column(sequence);
    let of_column = |row: &Row| {
        let value = row.values[column?]?;
        Some(Published { system: row.system, source: row.source, value })
    };
    rows.iter().filter_map(of_column).chain(on_same_frames.map(|(_, published)| *published)).collect()
}

/// Names and sources of all systems with figures of this kind, in the order of the tables.
pub fn systems(metric: Metric) -> Vec<(&'static str, &'static str)> {
    let rows: &[Row] = match metric {
        Metric::Ate => &ATE,
        Metric::RpeTranslation => &RPE_TRANSLATION,
        Metric::RpeRotation => &RPE_ROTATION,
    };
    let mut systems: Vec<_> = rows.iter().map(|row| (row.system, row.source)).collect();
    for (_, published) in SAME_FRAMES.iter().filter(|_| metric == Metric::Ate) {
        if !systems.contains(&(published.system, published.source)) {
            systems.push((published.system, published.source));
        }
    }
    systems
}

/// The paper's absolute error with a number of particles, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WithParticles {
    /// RMSE.
    pub rmse: f64,
    /// Standard deviation.
    pub deviation: f64,
}

/// Table 1 of the paper: a sequence with a number of particles.
pub fn with_particles(sequence: &str, particles: &str) -> Option<WithParticles> {
    let name = DYNAMIC[column(sequence)?];
    let number = PARTICLES.iter().position(|known| *known == particles)?;
    let (_, row) = TABLE_1.iter().find(|(known, _)| *known == name)?;
    let (rmse, deviation) = row[number];
    Some(WithParticles { rmse, deviation })
}

/// Columns of Table 1.
const PARTICLES: [&str; 4] = ["500", "800", "1000", "1200"];
/// RMSE and S.D.; tracking was lost for a while in the first cell of walking_half.
const TABLE_1: [(&str, [(f64, f64); 4]); 4] = [
    ("walking_xyz", [(0.079, 0.053), (0.059, 0.032), (0.015, 0.008), (0.018, 0.009)]),
    ("walking_half", [(0.315, 0.156), (0.050, 0.023), (0.049, 0.026), (0.051, 0.032)]),
    ("sitting_half", [(0.016, 0.009), (0.017, 0.011), (0.0142, 0.007), (0.0141, 0.006)]),
    ("sitting_xyz", [(0.009, 0.046), (0.008, 0.004), (0.008, 0.004), (0.008, 0.004)]),
];

/// The column of a sequence of the benchmark, whatever its spelling: `rgbd_dataset_freiburg3_walking_halfsphere`,
/// `fr3-walking-half`.
fn column(sequence: &str) -> Option<usize> {
    let name = sequence.to_lowercase().replace('-', "_");
    let is_freiburg3 = name.contains("freiburg3") || name.contains("fr3");
    let is_part = ["stills", "rgb10", "masks"].iter().any(|part| name.contains(part));
    DYNAMIC.iter().position(|known| name.contains(known)).filter(|_| is_freiburg3 && !is_part)
}

const PAPER: &str = "Zhang et al., Remote Sensing 2022, Tables 2–4";

const fn some(values: [f64; 8]) -> [Option<f64>; 8] {
    let mut all = [None; 8];
    let mut i = 0;
    while i < 8 {
        // NaN stands for "not published" in the tables below.
        if !values[i].is_nan() {
            all[i] = Some(values[i]);
        }
        i += 1;
    }
    all
}

const fn row(system: &'static str, source: &'static str, values: [f64; 8]) -> Row {
    Row { system, source, values: some(values) }
}

const X: f64 = f64::NAN;

const ATE: [Row; 14] = [
    row("PFD-SLAM", PAPER, [0.0060, 0.0086, 0.0176, 0.0142, 0.0081, 0.0155, 0.106, 0.0457]),
    row("ORB-SLAM2", PAPER, [0.008, 0.009, 0.019, 0.035, 0.390, 0.614, 0.937, 0.789]),
    row("MR-SLAM", PAPER, [X, 0.0514, X, 0.0664, 0.0656, 0.0932, 0.1333, 0.1252]),
    row("SPL-SLAM", PAPER, [X, 0.0182, X, 0.0405, 0.0077, 0.0391, 0.1810, 0.0615]),
    row("OPF-SLAM", PAPER, [0.0134, 0.0132, 0.0160, 0.0257, 0.0410, 0.3060, X, 0.3095]),
    row("DynaSLAM, as run for the paper", PAPER, [0.0064, 0.0136, 0.0438, 0.0217, 0.0077, 0.0162, 0.040, 0.0298]),
    row("DynaSLAM (GPU)", "Bescos et al., RA-L 2018", [X, 0.015, X, 0.017, 0.006, 0.015, 0.035, 0.025]),
    row("DynaSLAM, geometry only", "Bescos et al., RA-L 2018", [X, 0.009, X, 0.018, 0.009, 0.312, 0.251, 0.035]),
    row("CFP-SLAM (GPU)", "Hu et al., IROS 2022", [0.0053, 0.0090, 0.0253, 0.0147, 0.0066, 0.0141, 0.0368, 0.0237]),
    row("NGD-SLAM (YOLO on CPU)", "Zhang et al., 2024", [X, X, X, X, 0.007, 0.015, 0.034, 0.024]),
    row("LC-CRF SLAM", "Du et al., TVCG 2020", [X, 0.010, X, X, 0.014, 0.019, 0.057, 0.032]),
    row(
        "WildGS-SLAM (GPU; monocular, scale aligned)",
        "Zheng et al., CVPR 2025",
        [X, X, X, 0.017, 0.004, 0.012, 0.033, 0.014],
    ),
    row("MegaSaM (GPU; monocular, scale aligned)", "Li et al., CVPR 2025", [X, X, X, X, 0.006, 0.015, 0.026, 0.018]),
    row("DSLAM", "Dai et al., TPAMI 2020", [0.0096, 0.0091, 0.0225, 0.0235, 0.0108, 0.0874, 0.1608, 0.0354]),
];

const RPE_TRANSLATION: [Row; 6] = [
    row("PFD-SLAM", PAPER, [0.0077, 0.0112, 0.0244, 0.0163, 0.010, 0.020, 0.097, 0.0511]),
    row("ORB-SLAM2", PAPER, [0.0097, 0.0120, 0.0250, 0.0271, 0.213, 0.303, 0.446, 0.428]),
    row("MR-SLAM", PAPER, [X, 0.0357, X, 0.0547, 0.0307, 0.0688, 0.0968, 0.0611]),
    row("SPL-SLAM", PAPER, [0.0082, 0.0158, 0.0290, 0.0409, 0.0092, 0.0401, 0.1218, 0.0510]),
    row("OPF-SLAM", PAPER, [0.0171, 0.0169, 0.0226, 0.019, 0.054, 0.242, X, 0.133]),
    row("DynaSLAM, as run for the paper", PAPER, [0.0085, 0.0155, 0.0639, 0.0260, 0.0102, 0.021, 0.0529, 0.0272]),
];

const RPE_ROTATION: [Row; 6] = [
    row("PFD-SLAM", PAPER, [0.268, 0.480, 0.686, 0.607, 0.269, 0.636, 1.875, 0.867]),
    row("ORB-SLAM2", PAPER, [0.287, 0.480, 0.737, 0.641, 3.810, 5.413, 8.733, 8.700]),
    row("MR-SLAM", PAPER, [X, 1.036, X, 2.267, 0.899, 1.595, 2.594, 1.900]),
    row("SPL-SLAM", PAPER, [0.284, 0.558, 0.700, 1.434, 0.269, 0.923, 4.419, 1.557]),
    row("OPF-SLAM", PAPER, [0.424, 0.571, 0.730, 0.689, 1.01, 4.71, X, 2.685]),
    row("DynaSLAM, as run for the paper", PAPER, [0.277, 0.513, 0.946, 0.755, 0.265, 0.643, 1.134, 0.774]),
];

const fn orb_slam3(system: &'static str, value: f64) -> Published {
    Published { system, source: "ORB-SLAM3 (Campos et al., T-RO 2021) run on the same frames", value }
}

/// ORB-SLAM3 on sequences that are no published benchmark.
const SAME_FRAMES: [(&str, Published); 11] = [
    ("tum-fr1-xyz-first180", orb_slam3("ORB-SLAM3", 0.0105)),
    ("composite-demo", orb_slam3("ORB-SLAM3", 0.0119)),
    ("composite-demo", orb_slam3("ORB-SLAM3, movers painted out", 0.0123)),
    ("composite-walking", orb_slam3("ORB-SLAM3", 0.0243)),
    ("composite-walking", orb_slam3("ORB-SLAM3, movers painted out", 0.0117)),
    ("synthetic-dev-walking-xyz", orb_slam3("ORB-SLAM3", 0.119)),
    ("synthetic-dev-walking-xyz", orb_slam3("ORB-SLAM3, movers painted out", 0.0073)),
    ("synthetic-dev-walking-half", orb_slam3("ORB-SLAM3", 0.221)),
    ("synthetic-dev-walking-half", orb_slam3("ORB-SLAM3, movers painted out", 0.0065)),
    ("synthetic-dev-sitting-xyz", orb_slam3("ORB-SLAM3", 0.0046)),
    ("synthetic-dev-sitting-xyz", orb_slam3("ORB-SLAM3, movers painted out", 0.0045)),
];

#[cfg(test)]
mod tests {
    use super::*;

    fn paper(sequence: &str, metric: Metric) -> Option<f64> {
        of(sequence, metric).into_iter().find(|p| p.system == "PFD-SLAM").map(|p| p.value)
    }

    #[test]
    fn sequences_are_known_by_any_spelling() {
        assert_eq!(paper("rgbd_dataset_freiburg3_walking_halfsphere", Metric::Ate), Some(0.0457));
        assert_eq!(paper("fr3-walking-half", Metric::RpeRotation), Some(0.867));
        assert_eq!(paper("freiburg3_sitting_xyz", Metric::RpeTranslation), Some(0.0112));
        assert_eq!(paper("synthetic-dev-walking-xyz", Metric::Ate), None);
        assert_eq!(paper("tum-fr3-walking-xyz-stills", Metric::Ate), None);
    }

    #[test]
    fn the_first_table_is_known() {
        let figure = with_particles("rgbd_dataset_freiburg3_walking_halfsphere", "800");
        assert_eq!(figure, Some(WithParticles { rmse: 0.050, deviation: 0.023 }));
        assert_eq!(with_particles("freiburg3_walking_halfsphere", "600"), None);
        assert_eq!(with_particles("freiburg3_walking_rpy", "500"), None);
    }

    #[test]
    fn what_was_not_published_is_left_out() {
        assert!(of("fr3_walking_rpy", Metric::Ate).iter().all(|p| p.system != "OPF-SLAM"));
        assert_eq!(of("composite-demo", Metric::Ate).len(), 2);
        assert!(of("composite-demo", Metric::RpeRotation).is_empty());
    }
}
