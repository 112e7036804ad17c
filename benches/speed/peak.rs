//! Share of a core's peak rate of multiply-adds that an update reaches. Both are measured directly after each other.

use crate::clock::median;
use crate::table::CaseRow;
use crate::update::{Case, Updates, cases};
use crate::{Effort, products};

pub(crate) fn rows(effort: Effort) -> anyhow::Result<Vec<CaseRow>> {
    cases()?.iter().map(|case| row(case, effort)).collect()
}

fn row(case: &Case, effort: Effort) -> anyhow::Result<CaseRow> {
    let batch = case.batch();
    let mut updates = Updates::new(&case.settings, &case.problem, 1)?;
    updates.run(&batch)?;
    let (mut secs, mut peaks) = (Vec::new(), Vec::new());
    for _ in 0..effort.repeats.min(3) {
        secs.push(updates.run(&batch)?.whole.thread);
        peaks.push(products::peak(effort));
    }
    let flops = products::flops(&case.settings, &case.problem, case.rows());
    let (rate, peak) = (flops / median(secs) / 1e9, median(peaks));
    let figures =
        vec![("update, GFLOP/s", rate), ("peak, GFLOP/s", peak), ("share of peak", rate / peak)];
    Ok(CaseRow { case: case.name.clone(), figures })
}
