//! When a process that died is started again, and when it is given up.

/// A process that lived as long was well [ns].
const WELL_NS: u64 = 1_000_000_000;

/// Pause before the second restart in a row; every further one takes twice as long [ns].
const FIRST_PAUSE_NS: u64 = 50_000_000;

/// Longest pause [ns].
const PAUSE_NS_MAX: u64 = 2_000_000_000;

/// So many deaths in a row before it was ever ready, and a process is given up.
const UNREADY_DEATHS_MAX: u32 = 10;

/// The deaths of one process.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Deaths {
    /// In a row, each soon after its start.
    soon: u32,
    /// In a row, each before it was ready.
    unready: u32,
    restarts: u64,
}

/// What to do about a death.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Restart { after_ns: u64 },
    GiveUp,
}

impl Deaths {
    /// Counts a death after so long a life. The first restart comes at once.
    pub(crate) fn count(&mut self, lived_ns: u64, was_ready: bool) -> Verdict {
        self.soon = if lived_ns < WELL_NS { self.soon + 1 } else { 0 };
        self.unready = if was_ready { 0 } else { self.unready + 1 };
        if self.unready >= UNREADY_DEATHS_MAX {
            return Verdict::GiveUp;
        }
        self.restarts += 1;
        let doublings = self.soon.saturating_sub(2).min(16);
        let after_ns = if self.soon < 2 { 0 } else { (FIRST_PAUSE_NS << doublings).min(PAUSE_NS_MAX) };
        Verdict::Restart { after_ns }
    }

    /// How often it was started again.
    pub(crate) fn restarts(&self) -> u64 {
        self.restarts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_was_well_is_back_at_once_and_who_dies_young_waits_longer_and_longer() {
        let mut deaths = Deaths::default();
        let mut pause = |lived_ns| match deaths.count(lived_ns, true) {
            Verdict::Restart { after_ns } => after_ns / 1_000_000,
            Verdict::GiveUp => panic!("it was ready each time"),
        };
        assert_eq!([WELL_NS, 5, 5, 5, 5].map(&mut pause), [0, 0, 50, 100, 200]);
        assert_eq!((0..40).map(|_| pause(5)).last(), Some(2000));
        assert_eq!(pause(WELL_NS), 0, "it was well again");
        assert_eq!(deaths.restarts(), 46);
    }

    #[test]
    fn who_is_never_ready_is_given_up() {
        let mut deaths = Deaths::default();
        for _ in 1..UNREADY_DEATHS_MAX {
            assert_ne!(deaths.count(5, false), Verdict::GiveUp);
        }
        assert_eq!(deaths.count(5, false), Verdict::GiveUp);
    }
}
