//! `s2mia plot`: learning curves as SVG and PNG.

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::Context as _;

use crate::cli::PlotArguments;
use crate::learning_curve::{self, Curve};
use crate::{output, picture};

/// Writes both files and says where they are.
pub(super) fn run(arguments: &PlotArguments) -> anyhow::Result<()> {
    let curves = learning_curve::read_all(&arguments.runs)?;
    let picture = picture::draw(&learning_curve::series(&curves), &title(&curves))?;
    let folder = folder(arguments);
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("cannot make {}", folder.display()))?;
    for (name, bytes) in
        [("learning_curve.svg", picture.svg.as_bytes()), ("learning_curve.png", &picture.png)]
    {
        let path = folder.join(name);
        std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
        output::line(path.display());
    }
    Ok(())
}

fn folder(arguments: &PlotArguments) -> PathBuf {
    match (&arguments.out, arguments.runs.as_slice()) {
        (Some(folder), _) => folder.clone(),
        (None, [only]) => only.clone(),
        (None, _) => PathBuf::from("."),
    }
}

/// The tasks that are drawn; the simulator's name stands first, since returns are its own.
fn title(curves: &[Curve]) -> String {
    let tasks: BTreeSet<&str> = curves.iter().map(|curve| curve.task.as_str()).collect();
    let named: Vec<String> = tasks.into_iter().map(|task| format!("rapier/{task}")).collect();
    named.join(", ")
}
