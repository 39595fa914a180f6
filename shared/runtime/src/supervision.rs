//! What systemd is told about a service: that it is ready, that it works, what it does, and that it ends.
//!
//! A process that systemd did not start as `Type=notify` tells nobody.

use sd_notify::NotifyState;

use crate::Tally;

/// How often systemd hears what the process does, for `systemctl status` [ns].
const STATUS_PERIOD_NS: u64 = 1_000_000_000;

/// What systemd knows of this process. Dropping it says that the process ends.
#[derive(Debug, Default)]
pub(crate) struct Supervision {
    is_ready: bool,
    is_unheard: bool,
    status_due_ns: u64,
}

impl Supervision {
    /// Says that the process's own loop is at work at `now_ns`; the first time, that it is ready.
    ///
    /// Nothing else feeds the watchdog, so a loop that hangs is a process that systemd replaces.
    pub(crate) fn is_working(&mut self, what: &str, tally: &Tally, now_ns: u64) {
        let mut words = vec![NotifyState::Watchdog];
        if !self.is_ready {
            words.push(NotifyState::Ready);
        }
        let status = (now_ns >= self.status_due_ns).then(|| status(what, tally));
        if let Some(status) = &status {
            self.status_due_ns = now_ns + STATUS_PERIOD_NS;
            words.push(NotifyState::Status(status));
        }
        // What is not heard is said again the next time, so one line in the log is enough.
        match sd_notify::notify(&words) {
            Ok(()) => (self.is_ready, self.is_unheard) = (true, false),
            Err(error) if !self.is_unheard => {
                self.is_unheard = true;
                tracing::warn!("systemd does not hear how this process is: {error}");
            }
            Err(_) => {}
        }
    }
}

impl Drop for Supervision {
    fn drop(&mut self) {
        let _it_sees_the_end_by_itself = sd_notify::notify(&[NotifyState::Stopping]);
    }
}

fn status(what: &str, tally: &Tally) -> String {
    let counters = tally.counters;
    let mut status = format!("{what}; {} boxes", counters.handled);
    if counters.handled > 0 {
        status += &format!(", the last one {}", counters.last_box);
    }
    if counters.refused > 0 {
        status += &format!("; {} messages refused, the last one because {}", counters.refused, tally.refusal());
    }
    status
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_says_what_a_person_asks() {
        let mut tally = Tally::default();
        assert_eq!(status("one command a box", &tally), "one command a box; 0 boxes");
        tally.handle(7);
        tally.refuse(&"it has no box");
        assert_eq!(
            status("one command a box", &tally),
            "one command a box; 1 boxes, the last one 7; 1 messages refused, the last one because it has no box"
        );
    }
}
