//! `pfd-slam eval`.

use anyhow::Context;
use pfd_evaluation::{Statistics, ate, read_trajectory, rpe};
use pfd_report::summary::RPE_INTERVAL;
use serde::Serialize;

use crate::arguments::EvalArguments;
use crate::output;

/// What `--json` prints.
#[derive(Serialize)]
struct Errors {
    ate: Statistics,
    rpe_translation: Option<Statistics>,
    rpe_translation_evo: Option<Statistics>,
    rpe_rotation_deg: Option<Statistics>,
}

pub(crate) fn run(arguments: &EvalArguments) -> anyhow::Result<()> {
    let ground_truth = read_trajectory(&arguments.ground_truth)?;
    let estimate = read_trajectory(&arguments.estimate)?;
    let absolute = ate(&ground_truth, &estimate).with_context(|| arguments.estimate.display().to_string())?;
    let relative = rpe(&ground_truth, &estimate, RPE_INTERVAL);
    let errors = Errors {
        ate: absolute.statistics,
        rpe_translation: relative.as_ref().map(|r| r.translation),
        rpe_translation_evo: relative.as_ref().map(|r| r.translation_evo),
        rpe_rotation_deg: relative.as_ref().map(|r| r.rotation_deg),
    };
    if arguments.json { output::print_json(&errors) } else { output::print(&text(&errors)) }
}

fn text(errors: &Errors) -> String {
    let mut text = output::statistics_row("ATE (m)", &errors.ate);
    match errors.rpe_translation.zip(errors.rpe_rotation_deg) {
        Some((translation, rotation)) => {
            text += &output::statistics_row("RPE translation (m/s)", &translation);
            text += &output::statistics_row("RPE rotation (deg/s)", &rotation);
        }
        None => text += "RPE: none, no interval of one second with ground truth at both ends\n",
    }
    text
}
