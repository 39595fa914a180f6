//! The report of a soak: what an engineer shows to the plant.

use report::{Limit, Named, Page, Scale, Table, Timeline, percentile_curves, stack, timeline};
use runtime::Config;

use super::figures::Figures;
use super::incidents::LISTED_MAX;
use super::latency::{LATE_LISTED_MAX, Section};
use super::progress::{
    FAULT_COLUMNS, LATENCY_COLUMNS, PROCESS_COLUMNS, cells, facts, fault_rows, latency_rows, process_rows,
};
use super::watch::Story;
use crate::latency::STAGES;

/// Most faults whose names the page lists; the JSON has more.
const FAULTS_SHOWN_MAX: usize = 200;

/// A page that shows without a network.
pub(crate) fn soak(config: &Config, figures: &Figures, story: &Story) -> String {
    let pace = match config.perception.pace_ms {
        0 => "as fast as the cell decides (closed loop)".to_owned(),
        pace_ms => format!("one due every {pace_ms} ms (open loop)"),
    };
    let about = format!(
        "{} boxes of {}, {pace}; policy {}, {} containers open",
        figures.boxes, config.perception.stream, config.scorer.policy, config.container.slots
    );
    let mut page = Page::new("A cell soaked", &about);
    let latency = figures.latency_us["end_to_end"];
    let ms = |us: u64| format!("{:.2} ms", us as f64 / 1000.0);
    page.facts([
        ("boxes", figures.boxes.to_string()),
        ("lost", figures.lost.to_string()),
        ("doubled", figures.doubled.to_string()),
        ("over the budget", figures.over_budget.to_string()),
        ("p50", ms(latency.p50)),
        ("p99", ms(latency.p99)),
        ("p99.9", ms(latency.p99_9)),
        ("max", ms(latency.max)),
    ]);
    push_latency(&mut page, figures, story);
    push_processes(&mut page, figures, story);
    push_faults(&mut page, figures);
    push_late(&mut page, figures);
    page.section("All else");
    let mut table = Table::new(["what", "how much"]);
    for (what, value) in facts(figures).into_iter().chain(figures.machine.facts()) {
        table.row([what.to_owned(), value]);
    }
    table.row(["command".to_owned(), figures.command.clone()]);
    page.table(&table);
    page.to_html()
}

/// The percentile curve of the cell, and those of the bare machine.
pub(crate) fn curve(figures: &Figures, story: &Story) -> String {
    let in_ms = |points: &[(f64, f64)]| points.iter().map(|&(quantile, us)| (quantile, us / 1000.0)).collect();
    let named = |name: &str, points: &[(f64, f64)]| Named { name: name.to_owned(), points: in_ms(points) };
    let mut curves = vec![named("cell, due to command", &story.latencies.end_to_end.curve())];
    if let Some(baseline) = &story.baseline {
        curves.push(named("bare ping, there and back", &baseline.ping_curve));
        curves.push(named("bare timer", &baseline.timer_curve));
    }
    percentile_curves(&curves, "latency [ms]", &limit(figures))
}

fn limit(figures: &Figures) -> Limit {
    Limit { value: figures.budget_ms as f64, name: format!("{} ms", figures.budget_ms) }
}

fn push_latency(page: &mut Page, figures: &Figures, story: &Story) {
    page.section("Latency");
    page.text(
        "From when a box was due at the pick position to the publication of its command. A box that had to wait for \
         the one before it was due while it waited, so a stall is charged to every box that it delayed.",
    );
    page.figure(&curve(figures, story), "Percentile curve; every nine is as wide as the others.");
    let mut table = Table::new(LATENCY_COLUMNS);
    for (stage, percentiles) in latency_rows(figures) {
        let row = std::iter::once(stage.clone()).chain(cells(&percentiles));
        match stage.as_str() {
            "end_to_end" => table.strong_row(row),
            name if name.starts_with("bare") => table.quoted_row(row),
            _ => table.row(row),
        }
    }
    page.table(&table);
    if figures.baseline.is_some() {
        page.text(
            "The bare rows are the machine itself, measured in the same minutes: a thread that asks to be woken every \
             5 ms, and a message between two idle processes every 10 ms on a bus of their own.",
        );
    }
    let marks: Vec<(f64, String)> = story
        .incidents
        .marks()
        .map(|fault| {
            let cost = format!("{} boxes late, slowest {:.1} ms", fault.cost_boxes_late, fault.worst_ms);
            (fault.at_s, format!("{} {} at box {}: {cost}", fault.kind, fault.target, fault.at_box))
        })
        .collect();
    let line = |name: &str, of: &dyn Fn(&Section) -> f64| Named {
        name: name.to_owned(),
        points: story
            .latencies
            .sections()
            .filter(|(_, section)| section.count() > 0)
            .map(|(at_s, section)| (at_s, of(section) / 1000.0))
            .collect(),
    };
    let mut lines = vec![
        line("p50", &|section| section.at(0.5)),
        line("p99", &|section| section.at(0.99)),
        line("max", &Section::max_us),
    ];
    if !story.baseline_line.is_empty() {
        let points = story.baseline_line.iter().map(|&(at_s, ping_us, _)| (at_s, ping_us / 1000.0));
        lines.push(Named { name: "bare ping, slowest of a second".to_owned(), points: points.collect() });
    }
    let (x, y, limit) = ("time [s]", "latency [ms]", Some(limit(figures)));
    let chart = Timeline { x, y, scale: Scale::Log, lines: &lines, limit, marks: &marks };
    let caption = if marks.is_empty() {
        format!("Latency over time, in sections of {} s.", story.latencies.section_s())
    } else {
        format!(
            "Latency over time, in sections of {} s. The marks are the faults; point at one to read what it was.",
            story.latencies.section_s()
        )
    };
    page.figure(&timeline(&chart), &caption);
    let parts: Vec<Named> = (0..STAGES.len())
        .map(|stage| {
            let means = story.latencies.sections().filter(|(_, section)| section.count() > 0);
            let points = means.map(|(at_s, section)| (at_s, section.means_us()[stage]));
            Named { name: STAGES[stage].0.to_owned(), points: points.collect() }
        })
        .collect();
    page.figure(&stack("time [s]", "mean of a box [us]", &parts), "Where the time of a box goes, on average.");
}

fn push_processes(page: &mut Page, figures: &Figures, story: &Story) {
    page.section("Processes");
    let mut table = Table::new(PROCESS_COLUMNS);
    process_rows(figures).for_each(|row| table.row(row));
    page.table(&table);
    let bus = &figures.bus;
    let slope = bus.bytes_slope.map_or_else(String::new, |slope| format!(" ({:+.0} KiB an hour)", slope / 1024.0));
    let kib = |bytes: u64| bytes / 1024;
    page.text(&format!(
        "Shared memory of the bus after warm-up: {} files and {} KiB; at the end: {} files and {} KiB{slope}. Growth is \
         that of a straight line through the samples of the last life after 20 s. Switches, waits and faults are those \
         of a process's main thread.",
        bus.files_start,
        kib(bus.bytes_start),
        bus.files_end,
        kib(bus.bytes_end)
    ));
    let since_s = |at_ns: u64| at_ns.saturating_sub(story.began_ns) as f64 / 1e9;
    let mut lines: Vec<Named> = Vec::new();
    for (name, watched) in &story.processes.watched {
        let points = watched.line.points().iter().map(|sample| (since_s(sample.at_ns), sample.own_mib()));
        lines.push(Named { name: name.clone(), points: points.collect() });
    }
    let points = story.bus_line.iter().map(|&(at_s, bytes)| (at_s, bytes / f64::from(1 << 20)));
    lines.push(Named { name: "shared memory of the bus".to_owned(), points: points.collect() });
    let chart =
        Timeline { x: "time [s]", y: "memory [MiB]", scale: Scale::Linear, lines: &lines, limit: None, marks: &[] };
    page.figure(
        &timeline(&chart),
        "Memory of each process that is not shared, and that of the bus. A leak is a slope.",
    );
    let busy = story.cpu_line.iter().map(|&(at_s, busy, _)| (at_s, busy)).collect();
    let stolen = story.cpu_line.iter().map(|&(at_s, _, stolen)| (at_s, stolen)).collect();
    let lines = [
        Named { name: "busy with anything".to_owned(), points: busy },
        Named { name: "given to other virtual machines".to_owned(), points: stolen },
    ];
    let chart =
        Timeline { x: "time [s]", y: "processors [%]", scale: Scale::Linear, lines: &lines, limit: None, marks: &[] };
    page.figure(&timeline(&chart), "What the machine's processors did, the cell's work included.");
}

fn push_faults(page: &mut Page, figures: &Figures) {
    if figures.faults_count == 0 {
        return;
    }
    page.section("Faults, and what they cost");
    page.text(
        "A late box is charged to the newest fault that it met while that lasted or in the second after. \"Back\" is \
         the first command in which the killed or frozen stage had its part again, counted from the kill or the thaw.",
    );
    let mut table = Table::new(FAULT_COLUMNS);
    fault_rows(figures).for_each(|row| table.row(row));
    page.table(&table);
    let mut table =
        Table::new(["at [s]", "box", "fault", "target", "for [ms]", "boxes late", "slowest [ms]", "back [ms]", "note"]);
    for fault in figures.faults.iter().take(FAULTS_SHOWN_MAX) {
        table.row([
            format!("{:.1}", fault.at_s),
            fault.at_box.to_string(),
            fault.kind.to_owned(),
            fault.target.clone(),
            if fault.for_ms > 0 { fault.for_ms.to_string() } else { "-".to_owned() },
            fault.cost_boxes_late.to_string(),
            format!("{:.1}", fault.worst_ms),
            fault.back_ms.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.1}")),
            fault.note.clone(),
        ]);
    }
    page.table(&table);
    if figures.faults_count > FAULTS_SHOWN_MAX as u64 {
        let count = figures.faults_count;
        page.text(&format!("The first {FAULTS_SHOWN_MAX} of {count}; the JSON lists the first {LISTED_MAX}."));
    }
}

fn push_late(page: &mut Page, figures: &Figures) {
    if figures.late.is_empty() {
        return;
    }
    page.section("Boxes over the budget");
    if figures.over_budget > LATE_LISTED_MAX as u64 {
        page.text(&format!("The {LATE_LISTED_MAX} slowest of {}.", figures.over_budget));
    }
    let stages = STAGES.iter().map(|(name, _)| *name);
    let columns =
        ["box", "order", "what", "total [us]"].into_iter().chain(stages).chain(["candidates", "since the last look"]);
    let mut table = Table::new(columns);
    for late in &figures.late {
        let mut row =
            vec![late.box_id.to_string(), late.order.to_string(), late.action.to_owned(), late.latency_us.to_string()];
        for (name, _) in STAGES {
            row.push(late.stages_us.get(name).copied().flatten().map_or_else(|| "-".to_owned(), |us| us.to_string()));
        }
        row.extend([late.candidates.to_string(), late.circumstances.clone()]);
        table.row(row);
    }
    page.table(&table);
}
