//! The page of a demo: its figures, and a picture of every packed container; and how pages become files.

use std::fs;
use std::path::Path;

use anyhow::Context as _;
use report::{Page, Table, isometric};
use runtime::Config;

use crate::demo::latency_rows;
use crate::session::{Figures, Session};

/// Most containers that are drawn: those of a few episodes. The page says if there are more.
const DRAWN_MAX: usize = 64;

/// Writes figures, a picture or a page, and says so.
pub(crate) fn write_file(path: &Path, text: &str) -> anyhow::Result<()> {
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    println!("wrote {}", path.display());
    Ok(())
}

/// A page that shows without a network.
pub(crate) fn demo(config: &Config, session: &Session, figures: &Figures) -> String {
    let about = format!(
        "{} through four processes, policy {}, {} containers open",
        config.perception.stream, config.scorer.policy, config.container.slots
    );
    let mut page = Page::new("Packed by packcell", &about);
    page.section("What was packed");
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let or_unknown = |value: Option<String>| value.unwrap_or_else(|| "unknown".to_owned());
    page.facts([
        ("boxes placed", format!("{} of {}", figures.placed, figures.boxes)),
        ("set aside", figures.set_aside.to_string()),
        ("containers used", figures.containers_used.to_string()),
        ("c", or_unknown(figures.competitive_ratio.map(|c| format!("{c:.3}")))),
        ("fill", or_unknown(figures.fill.map(percent))),
        ("chosen by the model", figures.chosen_by.model.to_string()),
        ("chosen by a standby", figures.chosen_by.standby.to_string()),
        ("chosen by the fallback", figures.chosen_by.fallback.to_string()),
        ("over 40 ms", figures.over_budget.to_string()),
    ]);
    page.section("How long it took");
    page.text("From the observation of a box to the publication of its command, in microseconds.");
    let mut table = Table::new(["latency [us]", "count", "p50", "p99", "p99.9", "max"]);
    for (stage, row) in latency_rows(figures) {
        table.row(std::iter::once(stage.to_owned()).chain(row));
    }
    page.table(&table);
    page.section("The containers");
    let containers = session.containers();
    if containers.len() > DRAWN_MAX {
        page.text(&format!("The first {DRAWN_MAX} of {}.", containers.len()));
    }
    let size = session.container_size();
    page.gallery(containers.iter().take(DRAWN_MAX).map(|(container, boxes)| {
        let packed: u64 = boxes.iter().map(|one| one.spec.extent(size.cell_mm()).volume_cells()).sum();
        let share = percent(packed as f64 / size.volume_cells() as f64);
        (isometric(size, config.rules(), boxes), format!("container {container}: {} boxes, {share} full", boxes.len()))
    }));
    page.to_html()
}
