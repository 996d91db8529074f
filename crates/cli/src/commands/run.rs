//! `pfd-slam run`.

use anyhow::Context;

use crate::arguments::RunArguments;
use crate::progress::Progress;
use crate::runner::{self, Job};
use crate::{interrupt, results, setup};

pub(crate) fn run(arguments: &RunArguments) -> anyhow::Result<()> {
    interrupt::watch()?;
    let sequence = setup::sequence(&arguments.sequence, &arguments.reading)?;
    let mut config = setup::configuration(&arguments.config)?;
    config.mode = arguments.mode.unwrap_or(config.mode);
    config.seed = arguments.seed.unwrap_or(config.seed);
    let camera = setup::camera(&config, &sequence)?;
    std::fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    let job = Job {
        sequence: &sequence,
        camera,
        config: &config,
        max_frames: arguments.max_frames,
        given_masks: arguments.masks.as_deref(),
        video: arguments.video.as_deref(),
        save_masks: arguments.save_masks.then(|| arguments.out.join("masks")),
    };
    let progress = Progress::new(sequence.name(), job.frames());
    let outcome = runner::run(&job, &progress)?;
    progress.finish();
    let (summary, errors) = results::summarise(&job, &outcome)?;
    results::write(&arguments.out, &summary, &errors, &outcome)?;
    results::print(&summary, &arguments.out)
}
