//! `packcell journal`: what the commander wrote down.

use std::path::PathBuf;

use anyhow::Context as _;
use comfy_table::{Table, presets};
use journal::{Entry, Intent, Outcome, Record, Rest};
use messages::{Action, ChosenBy, Instance, MotionOutcome};

use crate::args::WhichCell;

#[derive(Debug, clap::Args)]
pub(crate) struct JournalArgs {
    #[command(flatten)]
    which: WhichCell,
    /// The journal; without it, that of the cell's state directory
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Show so many of the last entries; 0 for all
    #[arg(long, value_name = "N", default_value_t = 40)]
    last: usize,
    /// Print one JSON object a line
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &JournalArgs) -> anyhow::Result<()> {
    let path = match &args.file {
        Some(path) => path.clone(),
        None => args.which.config()?.state.journal(),
    };
    let contents = journal::read(&path).with_context(|| format!("cannot read the journal {}", path.display()))?;
    let skipped = if args.last == 0 { 0 } else { contents.entries.len().saturating_sub(args.last) };
    let shown = &contents.entries[skipped..];
    if args.json {
        for entry in shown {
            println!("{}", serde_json::to_string(entry)?);
        }
        return Ok(());
    }
    println!("{}", table(shown));
    let state = contents.state();
    println!("{} of {} entries of {}", shown.len(), contents.entries.len(), path.display());
    println!("next order {}, active scorer {}", state.next_order(), letter(state.active));
    if let Some(intent) = state.open() {
        println!("order {} for box {} is open: its motion has not been reported", intent.order, intent.spec.id);
    }
    match contents.rest {
        Rest::Nothing => {}
        Rest::Cut => println!("one more entry begins and is cut short: it is being written, or a crash cut it"),
        Rest::Damage => println!("what follows is damaged: the commander will put this file aside and go on from here"),
    }
    Ok(())
}

fn table(entries: &[Entry]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(["when [UTC]", "order", "what", "box", "size [mm]", "slot", "yaw", "i, j, base", "chosen by"]);
    for Entry { unix_ms, record } in entries {
        let row = match record {
            Record::Intent(intent) => intent_row(intent),
            Record::Outcome(Outcome { order, outcome }) => {
                let what = match outcome {
                    MotionOutcome::Done => "done",
                    MotionOutcome::Refused => "refused by the arm",
                    MotionOutcome::Unreported => "over, but not reported",
                };
                vec![order.to_string(), what.to_owned()]
            }
            Record::Active(instance) => vec![String::new(), format!("scorer {} is active", letter(*instance))],
            Record::Carried(state) => {
                vec![String::new(), format!("goes on after order {}", state.next_order().saturating_sub(1))]
            }
        };
        table.add_row(std::iter::once(time_of_day(*unix_ms)).chain(row));
    }
    table
}

fn intent_row(intent: &Intent) -> Vec<String> {
    let Intent { order, spec, action, placement, chosen_by, instance, .. } = intent;
    let what = match action {
        Action::Place => "place",
        Action::SetAside => "set aside",
        Action::Replace => "replace container",
    };
    let by = match chosen_by {
        ChosenBy::Model => format!("scorer {}", letter(*instance)),
        ChosenBy::Standby => format!("standby {}", letter(*instance)),
        ChosenBy::Fallback => "fallback".to_owned(),
        ChosenBy::Rules => "rules".to_owned(),
    };
    let [length, breadth, height] = spec.size_mm;
    vec![
        order.to_string(),
        what.to_owned(),
        spec.id.to_string(),
        format!("{length} x {breadth} x {height}"),
        placement.slot.to_string(),
        (90 * placement.yaw).to_string(),
        format!("{}, {}, {}", placement.i, placement.j, placement.base),
        by,
    ]
}

fn letter(instance: u32) -> String {
    Instance::from_wire(instance).map_or_else(|_| instance.to_string(), |instance| instance.to_string())
}

fn time_of_day(unix_ms: u64) -> String {
    if unix_ms == 0 {
        return String::new();
    }
    let (seconds, ms) = (unix_ms / 1000 % 86_400, unix_ms % 1000);
    format!("{:02}:{:02}:{:02}.{ms:03}", seconds / 3600, seconds / 60 % 60, seconds % 60)
}
