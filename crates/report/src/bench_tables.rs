//! The tables of a bench: medians over the seeds, like the tables of the paper.

use pfd_evaluation::{MaskSummary, Statistics};

use crate::Summary;
use crate::bench::{BenchRun, Group, select, sequences, variants};
use crate::published::{self, Metric};
use crate::summary::{Percentiles, Timing};
use crate::table::{Table, number, percent};

/// Beginning of the variants that compare numbers of particles.
const PARTICLES: &str = "segmentation.particles.count=";

/// All tables that the runs give.
pub fn tables(runs: &[BenchRun]) -> Vec<Table> {
    let mut tables = Vec::new();
    for error in &ERRORS {
        tables.push(grid(runs, &format!("{}, {}", error.title, error.unit), RMSE_NOTE, |group| error.cell(group)));
        tables.extend(error.beside_others(runs));
    }
    tables.extend(particles(runs));
    tables.push(grid(runs, "Frames with a pose", "Share of the frames.", |group| {
        percent(group.median(|run| Some(run.summary.tracked)))
    }));
    tables.push(times(runs));
    tables.extend(stages(runs));
    tables.extend(masks(runs));
    tables
}

const RMSE_NOTE: &str = "RMSE, in brackets the standard deviation. Median over the seeds.";

/// One kind of error.
struct Error {
    title: &'static str,
    unit: &'static str,
    metric: Metric,
    decimals: usize,
    of: fn(&Summary) -> Option<Statistics>,
}

/// Tables 2 to 7 of the paper.
const ERRORS: [Error; 3] = [
    Error { title: "Absolute trajectory error (ATE)", unit: "m", metric: Metric::Ate, decimals: 4, of: |s| s.ate },
    Error {
        title: "Relative pose error, translation",
        unit: "m/s",
        metric: Metric::RpeTranslation,
        decimals: 4,
        of: |s| s.rpe_translation,
    },
    Error {
        title: "Relative pose error, rotation",
        unit: "deg/s",
        metric: Metric::RpeRotation,
        decimals: 3,
        of: |s| s.rpe_rotation_deg,
    },
];

impl Error {
    fn rmse(&self, group: Group<'_>) -> Option<f64> {
        group.median(|run| (self.of)(&run.summary).map(|s| s.rmse))
    }

    /// RMSE (S.D.)
    fn cell(&self, group: Group<'_>) -> String {
        let Some(rmse) = self.rmse(group) else { return "–".to_owned() };
        let deviation = group.median(|run| (self.of)(&run.summary).map(|s| s.std));
        format!("{} ({})", number(Some(rmse), self.decimals), number(deviation, self.decimals))
    }

    /// Ours beside published figures: a row per system, a column per sequence that is known by name.
    fn beside_others(&self, runs: &[BenchRun]) -> Option<Table> {
        let known: Vec<&str> =
            sequences(runs).into_iter().filter(|s| !published::of(s, self.metric).is_empty()).collect();
        let ours = variants(runs).into_iter().map(|variant| {
            let cell = |sequence: &&str| number(self.rmse(Group(&select(runs, sequence, variant))), self.decimals);
            let cells = known.iter().map(cell);
            std::iter::once(format!("ours, {variant}")).chain(cells).chain(["this run".to_owned()]).collect()
        });
        let theirs = published::systems(self.metric).into_iter().filter_map(|(system, source)| {
            let value = |sequence: &&str| {
                published::of(sequence, self.metric).into_iter().find(|p| (p.system, p.source) == (system, source))
            };
            let values: Vec<Option<f64>> = known.iter().map(|sequence| value(sequence).map(|p| p.value)).collect();
            let cells = values.iter().map(|v| number(*v, self.decimals));
            let row = std::iter::once(system.to_owned()).chain(cells).chain([source.to_owned()]).collect();
            values.iter().any(Option::is_some).then_some(row)
        });
        let short = |name: &&str| name.trim_start_matches("rgbd_dataset_").replace("freiburg", "fr");
        let names = known.iter().map(short);
        let header = std::iter::once("system".to_owned()).chain(names).chain(["source".to_owned()]);
        (!known.is_empty()).then(|| Table {
            title: format!("{} beside others, RMSE, {}", self.title, self.unit),
            note: "Other systems' figures are quoted from their source, on other hardware.".to_owned(),
            header: header.collect(),
            rows: ours.chain(theirs).collect(),
        })
    }
}

/// A table with a row per sequence and a column per variant.
fn grid(runs: &[BenchRun], title: &str, note: &str, cell: impl Fn(Group<'_>) -> String) -> Table {
    let variants = variants(runs);
    let row = |sequence: &str| {
        let cells = variants.iter().map(|variant| match select(runs, sequence, variant).as_slice() {
            [] => "–".to_owned(),
            group => cell(Group(group)),
        });
        std::iter::once(sequence.to_owned()).chain(cells).collect()
    };
    Table {
        title: title.to_owned(),
        note: note.to_owned(),
        header: std::iter::once("sequence").chain(variants.iter().copied()).map(str::to_owned).collect(),
        rows: sequences(runs).into_iter().map(row).collect(),
    }
}

/// Table 1 of the paper: the absolute error over the number of particles, where that was varied.
fn particles(runs: &[BenchRun]) -> Option<Table> {
    let numbers: Vec<&str> = variants(runs).into_iter().filter_map(|v| v.strip_prefix(PARTICLES)).collect();
    let mut rows = Vec::new();
    for sequence in sequences(runs) {
        let ours = |number: &&str| match select(runs, sequence, &format!("{PARTICLES}{number}")).as_slice() {
            [] => "–".to_owned(),
            group => ERRORS[0].cell(Group(group)),
        };
        rows.push([vec![sequence.to_owned(), "ours".to_owned()], numbers.iter().map(ours).collect()].concat());
        let published = |n: &&str| {
            let figure = published::with_particles(sequence, n)?;
            Some(format!("{} ({})", number(Some(figure.rmse), 4), number(Some(figure.deviation), 4)))
        };
        let cells: Vec<Option<String>> = numbers.iter().map(published).collect();
        if cells.iter().any(Option::is_some) {
            let cells = cells.into_iter().map(|c| c.unwrap_or("–".to_owned())).collect();
            rows.push([vec![sequence.to_owned(), "the paper, Table 1".to_owned()], cells].concat());
        }
    }
    let header = ["sequence", "system"].into_iter().chain(numbers.iter().copied()).map(str::to_owned).collect();
    (!numbers.is_empty()).then(|| Table {
        title: "Absolute trajectory error over the number of particles, m".to_owned(),
        note: RMSE_NOTE.to_owned(),
        header,
        rows,
    })
}

/// Times per frame, a row per sequence and variant.
fn times(runs: &[BenchRun]) -> Table {
    const PARTS: [fn(&Timing) -> Percentiles; 3] = [|t| t.segmentation, |t| t.tracking, |t| t.total];
    let mut rows = Vec::new();
    for sequence in sequences(runs) {
        for variant in variants(runs) {
            let selected = select(runs, sequence, variant);
            let at = |value: &dyn Fn(&Timing) -> f64| {
                number(Group(&selected).median(|run| Some(value(&run.summary.timing_ms))), 1)
            };
            let cells = PARTS.iter().map(|part| format!("{} ({})", at(&|t| part(t).median), at(&|t| part(t).p99)));
            if !selected.is_empty() {
                rows.push([sequence.to_owned(), variant.to_owned()].into_iter().chain(cells).collect());
            }
        }
    }
    let header = ["sequence", "variant", "segmentation", "tracking", "total"];
    Table {
        title: "Time per frame, ms".to_owned(),
        note: "Median over the frames, in brackets what 99 of 100 frames stay below. Median over the seeds.".to_owned(),
        header: header.map(str::to_owned).to_vec(),
        rows,
    }
}

/// Table 8 of the paper: time per module, over all sequences.
fn stages(runs: &[BenchRun]) -> Option<Table> {
    let variants = variants(runs);
    let mut names: Vec<&str> = Vec::new();
    for stage in runs.iter().flat_map(|run| &run.summary.stages_ms) {
        if !names.contains(&stage.stage.as_str()) {
            names.push(&stage.stage);
        }
    }
    names.sort_by_key(|name| name.split(':').next().unwrap_or_default().to_owned());
    let of_variant = |variant: &str| runs.iter().filter(|run| run.variant == variant).collect::<Vec<_>>();
    let row = |name: &&str| {
        let time =
            |run: &BenchRun| run.summary.stages_ms.iter().find(|s| s.stage == **name).map(|s| s.percentiles.mean);
        let cells = variants.iter().map(|variant| number(Group(&of_variant(variant)).median(time), 2));
        std::iter::once((*name).to_owned()).chain(cells).collect()
    };
    (!names.is_empty()).then(|| Table {
        title: "Time per module, ms".to_owned(),
        note: "Mean over the frames in which a module runs; median over sequences and seeds. The paper (Table 8, TUM, i5-8250U): \
               tracking and segmentation of moving objects 82.2, extraction of static features 1.28, tracking 25.5."
            .to_owned(),
        header: std::iter::once("module").chain(variants.iter().copied()).map(str::to_owned).collect(),
        rows: names.iter().map(row).collect(),
    })
}

/// Quality of the masks; `None` when no sequence has true ones.
fn masks(runs: &[BenchRun]) -> Option<Table> {
    let mut rows = Vec::new();
    for sequence in sequences(runs) {
        for variant in variants(runs) {
            let runs = select(runs, sequence, variant);
            let group = Group(&runs);
            let share =
                |of: fn(&MaskSummary) -> Option<f64>| percent(group.median(|run| run.masks.as_ref().and_then(of)));
            if group.0.iter().any(|run| run.masks.is_some()) {
                let shares = [
                    share(|m| m.precision),
                    share(|m| m.recall),
                    share(|m| m.iou),
                    share(|m| m.static_masked.mean),
                    share(|m| m.static_masked.max),
                ];
                rows.push([vec![sequence.to_owned(), variant.to_owned()], shares.to_vec()].concat());
            }
        }
    }
    let header = ["sequence", "variant", "precision", "recall", "IoU", "static pixels masked", "worst frame"];
    let note = "Means over the frames in which something moves; static pixels over all frames.".to_owned();
    (!rows.is_empty()).then(|| Table {
        title: "Masks".to_owned(),
        note,
        header: header.map(str::to_owned).to_vec(),
        rows,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::tests::run;

    fn find(runs: &[BenchRun], title: &str) -> Table {
        tables(runs).into_iter().find(|t| t.title.contains(title)).unwrap()
    }

    #[test]
    fn cells_are_medians_over_seeds() {
        let runs =
            [run("a", "pfd", 0, 0.3), run("a", "pfd", 1, 0.1), run("a", "pfd", 2, 0.2), run("b", "none", 0, 1.0)];
        let table = &tables(&runs)[0];
        assert_eq!(table.header, ["sequence", "pfd", "none"]);
        assert_eq!(table.rows[0][1..], ["0.2000 (0.0000)", "–"]);
        assert_eq!(table.rows[1][1..], ["–", "1.0000 (0.0000)"]);
        assert_eq!(find(&runs, "Time per frame").rows.len(), 2);
    }

    #[test]
    fn known_sequences_stand_beside_published_figures() {
        let runs = [
            run("rgbd_dataset_freiburg3_walking_xyz", "pfd", 0, 0.012),
            run("composite-demo", "pfd", 0, 0.013),
            run("my-room", "pfd", 0, 0.014),
        ];
        let table = find(&runs, "(ATE) beside others");
        assert_eq!(table.header[1..3], ["fr3_walking_xyz", "composite-demo"]);
        assert_eq!(table.header.len(), 4, "what nobody published is no column: {:?}", table.header);
        assert_eq!(table.rows[0][..3], ["ours, pfd", "0.0120", "0.0130"]);
        let row = |system: &str| table.rows.iter().find(|row| row[0] == system).unwrap()[1..3].to_vec();
        assert_eq!(row("ORB-SLAM2"), ["0.6140", "–"]);
        assert_eq!(row("ORB-SLAM3"), ["–", "0.0119"]);
    }

    #[test]
    fn numbers_of_particles_make_the_first_table_of_the_paper() {
        let variant = |n: u32| format!("{PARTICLES}{n}");
        let runs = [run("fr3_walking_xyz", &variant(500), 0, 0.08), run("fr3_walking_xyz", &variant(1000), 0, 0.02)];
        let table = find(&runs, "number of particles");
        assert_eq!(table.header, ["sequence", "system", "500", "1000"]);
        assert_eq!(table.rows[0][2..], ["0.0800 (0.0000)", "0.0200 (0.0000)"]);
        assert_eq!(table.rows[1][2..], ["0.0790 (0.0530)", "0.0150 (0.0080)"]);
        assert!(particles(&[run("a", "pfd", 0, 1.0)]).is_none());
    }

    #[test]
    fn modules_keep_the_order_in_which_they_run() {
        let mut one = run("a", "pfd", 0, 1.0);
        let stage = |name: &str, mean: f64| crate::summary::StageTiming {
            stage: name.to_owned(),
            percentiles: Percentiles { mean, ..Percentiles::default() },
        };
        one.summary.stages_ms = vec![stage("segmentation: warp", 1.5), stage("segmentation: evidence", 2.0)];
        let mut two = run("a", "none", 0, 1.0);
        two.summary.stages_ms = vec![stage("tracking: features", 3.0)];
        let table = find(&[one, two], "Time per module");
        assert_eq!(table.rows[0], ["segmentation: warp", "1.50", "–"]);
        assert_eq!(table.rows[2], ["tracking: features", "–", "3.00"]);
    }
}
