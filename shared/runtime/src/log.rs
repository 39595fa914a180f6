//! The log of a process: lines on stderr, and for a service under systemd, fields in the journal.

use std::io::{self, IsTerminal as _};

use rustix::fs::fstat;
use tracing::Subscriber;
use tracing_journald::{Priority, PriorityMappings};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::LogLevel;

/// Starts the log of a tool: lines on stderr. A second call changes nothing.
pub fn init_log(level: LogLevel) {
    let lines = tracing_subscriber::fmt().with_writer(io::stderr).with_target(false);
    // A line that a full disk does not take is lost; it is nothing to die of.
    let lines = lines.with_ansi(io::stderr().is_terminal()).with_max_level(level.filter()).log_internal_errors(false);
    let _the_first_caller_decides = lines.try_init();
}

/// Starts the log of a service.
///
/// If its stderr goes to the journal, it writes there itself, with fields by which lines can be selected:
/// `PACKCELL_BOX`, `PACKCELL_INSTANCE`, and its program as `PACKCELL_STAGE`. Otherwise it writes lines to stderr. Either
/// way the message alone says what a person needs: the journal shows no fields unless it is asked.
pub(crate) fn init_service_log(level: LogLevel) {
    let journal = if stderr_is_the_journal() { tracing_journald::layer().ok() } else { None };
    if let Some(layer) = journal {
        let subscriber = tracing_subscriber::registry().with(level.filter()).with(with_fields(layer));
        let _the_first_caller_decides = subscriber.try_init();
    } else {
        init_log(level);
    }
}

fn with_fields<S>(layer: tracing_journald::Layer) -> impl Layer<S>
where
    S: Subscriber + for<'span> tracing_subscriber::registry::LookupSpan<'span>,
{
    let stage = layer.syslog_identifier().to_owned();
    let levels = PriorityMappings {
        error: Priority::Error,
        warn: Priority::Warning,
        info: Priority::Informational,
        debug: Priority::Debug,
        trace: Priority::Debug,
    };
    layer
        .with_field_prefix(Some("PACKCELL".to_owned()))
        .with_priority_mappings(levels)
        .with_custom_fields([("PACKCELL_STAGE", stage)])
}

/// Whether stderr is the stream that systemd opened for this process, as systemd says where it is.
#[expect(clippy::disallowed_methods, reason = "it is systemd's way to say so, and no setting")]
fn stderr_is_the_journal() -> bool {
    let named = std::env::var("JOURNAL_STREAM").ok();
    let named = named.as_deref().and_then(|stream| stream.split_once(':'));
    let own = fstat(io::stderr()).ok().map(|stat| (stat.st_dev.to_string(), stat.st_ino.to_string()));
    own.as_ref().map(|(device, inode)| (device.as_str(), inode.as_str())) == named && named.is_some()
}
