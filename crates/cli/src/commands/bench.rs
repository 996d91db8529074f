//! `pfd-slam bench`: sequences × variants × seeds, tables and one page.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::Context;
use pfd_dataset::Sequence;
use pfd_evaluation::read_trajectory;
use pfd_pipeline::SlamConfig;
use pfd_report::bench::{BenchRun, CsvRow, median_run, sequences, variants};
use pfd_report::bench_page::{self, Detail};
use pfd_report::bench_summary;
use pfd_report::bench_tables::tables;
use pfd_report::summary::Errors;
use pfd_report::{FrameRow, Summary, frames};

use crate::arguments::{BenchArguments, BenchMode, ConfigSource, SequenceArguments};
use crate::commands::eval_masks;
use crate::commands::report::samples;
use crate::interrupt::Interrupted;
use crate::progress::Progress;
use crate::runner::{self, Job};
use crate::{interrupt, output, provenance, results, setup};

/// Folder of the true masks in a sequence.
const TRUE_MASKS: &str = "mask";
/// Parameter that says how moving things are found.
const MODE: &str = "mode";
/// File beside each run that says what it was made from.
const SOURCE: &str = "source.txt";

pub(crate) fn run(arguments: &BenchArguments) -> anyhow::Result<()> {
    interrupt::watch()?;
    let plan = Plan::new(arguments)?;
    if let Some(file) = &arguments.into {
        // Whether it has a place for the summary is said before hours of work.
        check_place(file)?;
    }
    anyhow::ensure!(
        !plan.cells().is_empty(),
        "nothing to run: `given` needs true masks in SEQUENCE/{TRUE_MASKS}, and no sequence has this folder"
    );
    let mut failures = plan.execute(arguments.jobs as usize)?;
    let runs = plan.collect(&mut failures)?;
    anyhow::ensure!(!runs.is_empty(), "no run succeeded: {}", failures.join("; "));
    write(&arguments.out, &plan, &runs)?;
    if let Some(file) = &arguments.into {
        insert_summary(file, &runs, &arguments.about)?;
    }
    anyhow::ensure!(failures.is_empty(), "{} failures: {}", failures.len(), failures.join("; "));
    Ok(())
}

/// A column of the tables.
struct Variant {
    name: String,
    config: SlamConfig,
    given_masks: bool,
}

/// Everything that is to be run.
struct Plan {
    out: PathBuf,
    sequences: Vec<Sequence>,
    variants: Vec<Variant>,
    runs: u64,
    max_frames: Option<usize>,
    reading: SequenceArguments,
}

/// One run of the plan.
#[derive(Clone, Copy)]
struct Cell<'a> {
    sequence: &'a Sequence,
    variant: &'a Variant,
    seed: u64,
}

impl Plan {
    fn new(arguments: &BenchArguments) -> anyhow::Result<Self> {
        let open = |path: &PathBuf| setup::sequence(path, &arguments.reading);
        let sequences: Vec<Sequence> = arguments.sequences.iter().map(open).collect::<anyhow::Result<_>>()?;
        for (i, sequence) in sequences.iter().enumerate() {
            let is_repeated = sequences[..i].iter().any(|other| other.name() == sequence.name());
            anyhow::ensure!(
                !is_repeated,
                "two sequences are named {}: results could not be told apart",
                sequence.name()
            );
        }
        Ok(Self {
            out: arguments.out.clone(),
            sequences,
            variants: variants_of(arguments)?,
            runs: arguments.runs,
            max_frames: arguments.max_frames,
            reading: arguments.reading.clone(),
        })
    }

    /// What a run is made from, beside its configuration.
    fn source(&self, cell: Cell<'_>) -> anyhow::Result<String> {
        let masks = true_masks(cell.sequence);
        provenance::of(cell.sequence, &self.reading, cell.variant.given_masks.then_some(&masks))
    }

    /// All runs; those with true masks only where there are some.
    fn cells(&self) -> Vec<Cell<'_>> {
        let mut cells = Vec::new();
        for sequence in &self.sequences {
            for variant in self.variants.iter().filter(|v| !v.given_masks || true_masks(sequence).is_dir()) {
                cells.extend((0..self.runs).map(|run| Cell { sequence, variant, seed: variant.config.seed + run }));
            }
        }
        cells
    }

    fn folder(&self, cell: Cell<'_>) -> PathBuf {
        // A value may hold a slash; a folder's name may not.
        let variant = cell.variant.name.replace('/', "_");
        self.out.join("runs").join(cell.sequence.name()).join(variant).join(cell.seed.to_string())
    }

    /// Runs what has not been run yet, and returns what went wrong.
    fn execute(&self, jobs: usize) -> anyhow::Result<Vec<String>> {
        let mut todo = Vec::new();
        for cell in self.cells() {
            if !self.is_done(cell)? {
                todo.push(cell);
            }
        }
        let frames = todo.iter().map(|cell| cell.sequence.len().min(self.max_frames.unwrap_or(usize::MAX))).sum();
        let (progress, next, failures) = (Progress::new("bench", frames), AtomicUsize::new(0), Mutex::new(Vec::new()));
        let work = || {
            while let Some(cell) = todo.get(next.fetch_add(1, Ordering::Relaxed)) {
                if let Err(error) = self.run(*cell, &progress) {
                    if error.is::<Interrupted>() {
                        return;
                    }
                    let failure = cell.failure(&error);
                    progress.note(&failure);
                    failures.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(failure);
                }
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..jobs {
                scope.spawn(work);
            }
        });
        progress.finish();
        interrupt::check()?;
        Ok(failures.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    fn run(&self, cell: Cell<'_>, progress: &Progress) -> anyhow::Result<()> {
        let config = cell.config();
        let folder = self.folder(cell);
        let masks = true_masks(cell.sequence);
        let source = self.source(cell)?;
        prepare(&folder).with_context(|| folder.display().to_string())?;
        let job = Job {
            sequence: cell.sequence,
            camera: setup::camera(&config, cell.sequence)?,
            config: &config,
            max_frames: self.max_frames,
            given_masks: cell.variant.given_masks.then_some(masks.as_path()),
            save_masks: Some(folder.join("masks")),
            video: None,
        };
        let outcome = runner::run(&job, progress)?;
        let (summary, errors) = results::summarise(&job, &outcome)?;
        results::write(&folder, &summary, &errors, &outcome)?;
        std::fs::write(folder.join(SOURCE), source).with_context(|| folder.display().to_string())
    }

    /// Whether the folder holds a run of the same program on the same frames with the same configuration.
    fn is_done(&self, cell: Cell<'_>) -> anyhow::Result<bool> {
        let folder = self.folder(cell);
        let Ok(summary) = Summary::read(&folder.join("report.json")) else { return Ok(false) };
        if std::fs::read_to_string(folder.join(SOURCE)).ok() != Some(self.source(cell)?) {
            return Ok(false);
        }
        let frames = cell.sequence.len().min(self.max_frames.unwrap_or(usize::MAX));
        Ok(summary.frames + summary.skipped == frames && summary.config == serde_json::to_value(cell.config())?)
    }

    /// The results of all runs that are there. Masks that cannot be judged are noted among the failures.
    fn collect(&self, failures: &mut Vec<String>) -> anyhow::Result<Vec<BenchRun>> {
        let mut runs = Vec::new();
        for cell in self.cells() {
            if self.is_done(cell)? {
                let summary = Summary::read(&self.folder(cell).join("report.json"))?;
                let masks = self.mask_quality(cell).unwrap_or_else(|error| {
                    failures.push(cell.failure(&error));
                    None
                });
                runs.push(BenchRun { variant: cell.variant.name.clone(), summary, masks });
            }
        }
        Ok(runs)
    }

    fn mask_quality(&self, cell: Cell<'_>) -> anyhow::Result<Option<pfd_evaluation::MaskSummary>> {
        let truth = true_masks(cell.sequence);
        if cell.variant.given_masks || !truth.is_dir() {
            return Ok(None);
        }
        Ok(Some(eval_masks::compare(&self.folder(cell).join("masks"), &truth)?.summary))
    }

    /// The median runs in detail.
    fn details(&self, runs: &[BenchRun]) -> anyhow::Result<Vec<Detail>> {
        let mut details = Vec::new();
        for sequence in sequences(runs) {
            for variant in variants(runs) {
                let Some(run) = median_run(runs, sequence, variant) else { continue };
                let is_it = |c: &Cell<'_>| {
                    c.sequence.name() == sequence && c.variant.name == variant && c.seed == run.summary.seed
                };
                if let Some(cell) = self.cells().into_iter().find(is_it) {
                    details.push(detail(cell, &self.folder(cell))?);
                }
            }
        }
        Ok(details)
    }
}

impl Cell<'_> {
    /// One line that names the run.
    fn failure(self, error: &anyhow::Error) -> String {
        format!("{} {}: {error:#}", self.sequence.name(), self.variant.name)
    }

    fn config(self) -> SlamConfig {
        SlamConfig { seed: self.seed, ..self.variant.config.clone() }
    }
}

/// Makes an empty folder for a run.
fn prepare(folder: &Path) -> std::io::Result<()> {
    if folder.exists() {
        // First, so that a run that is interrupted from here on does not count as done.
        remove_if_there(&folder.join(SOURCE))?;
        std::fs::remove_dir_all(folder)?;
    }
    std::fs::create_dir_all(folder)
}

fn remove_if_there(file: &Path) -> std::io::Result<()> {
    match std::fs::remove_file(file) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

fn true_masks(sequence: &Sequence) -> PathBuf {
    sequence.folder().join(TRUE_MASKS)
}

fn detail(cell: Cell<'_>, folder: &Path) -> anyhow::Result<Detail> {
    let rows: Vec<FrameRow> = frames::read(&folder.join("frames.csv"))?;
    let trajectory = read_trajectory(&folder.join("trajectory.txt"))?;
    Ok(Detail {
        sequence: cell.sequence.name().to_owned(),
        variant: cell.variant.name.clone(),
        errors: Errors::of(cell.sequence.ground_truth(), &trajectory),
        samples: samples(cell.sequence, &rows, &folder.join("masks"))?,
        frames: rows,
    })
}

/// The modes, then the values to vary (with the first mode).
fn variants_of(arguments: &BenchArguments) -> anyhow::Result<Vec<Variant>> {
    let mut named = arguments.config.set.iter().chain(&arguments.vary);
    anyhow::ensure!(
        named.all(|(name, _)| name != MODE),
        "parameter `{MODE}` is the column of a bench, not one of its settings: use --modes"
    );
    let mut variants = Vec::new();
    for &mode in &arguments.modes {
        variants.push(variant(mode.to_string(), mode, &arguments.config)?);
    }
    for (name, values) in &arguments.vary {
        for value in split_values(values) {
            let mut source = arguments.config.clone();
            source.set.push((name.clone(), value.to_owned()));
            variants.push(variant(format!("{name}={value}"), arguments.modes[0], &source)?);
        }
    }
    Ok(variants)
}

/// The values of a list, separated by commas; those inside brackets belong to a value.
fn split_values(list: &str) -> Vec<&str> {
    let mut depth = 0_i32;
    let is_separator = |c: char| {
        match c {
            '[' | '{' => depth += 1,
            ']' | '}' => depth -= 1,
            _ => {}
        }
        c == ',' && depth == 0
    };
    list.split(is_separator).collect()
}

fn variant(name: String, mode: BenchMode, source: &ConfigSource) -> anyhow::Result<Variant> {
    let mut config = setup::configuration(source)?;
    if let BenchMode::Mode(mode) = mode {
        config.mode = mode;
    }
    Ok(Variant { name, config, given_masks: mode == BenchMode::Given })
}

fn write(out: &Path, plan: &Plan, runs: &[BenchRun]) -> anyhow::Result<()> {
    let markdown: String = tables(runs).iter().map(pfd_report::table::Table::markdown).collect();
    let put = |name: &str, content: &str| pfd_report::error::write(&out.join(name), content);
    put("bench.md", &markdown)?;
    put("bench.json", &(serde_json::to_string_pretty(runs)? + "\n"))?;
    put("bench.html", &bench_page::page(runs, &plan.details(runs)?)?)?;
    frames::write(&out.join("bench.csv"), &runs.iter().map(CsvRow::from).collect::<Vec<_>>())?;
    output::print(&format!("{markdown}page: {}\n", out.join("bench.html").display()))
}

/// Replaces the summary that stands in a file.
fn check_place(file: &Path) -> anyhow::Result<()> {
    let named = || file.display().to_string();
    let text = std::fs::read_to_string(file).with_context(named)?;
    bench_summary::insert(&text, "").map(drop).with_context(named)
}

fn insert_summary(file: &Path, runs: &[BenchRun], about: &str) -> anyhow::Result<()> {
    let named = || file.display().to_string();
    let text = std::fs::read_to_string(file).with_context(named)?;
    let text = bench_summary::insert(&text, &bench_summary::summary(runs, about)).with_context(named)?;
    Ok(pfd_report::error::write(file, text)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commas_inside_brackets_separate_no_values() {
        assert_eq!(split_values("500,1000"), ["500", "1000"]);
        assert_eq!(split_values("[0,0],[1,2],3"), ["[0,0]", "[1,2]", "3"]);
        assert_eq!(split_values(""), [""]);
    }
}
