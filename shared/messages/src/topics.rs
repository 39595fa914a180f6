//! The table of everything that crosses a process border.
//!
//! | topic | message | who -> who | wakes |
//! |---|---|---|---|
//! | `packcell/belief` | [`Belief`] | perception -> candidates, scorers, commander | nobody: read on demand |
//! | `packcell/boxes` | [`BoxQueue`] | perception -> candidates, tools | candidates |
//! | `packcell/candidates` | [`CandidateSet`] | candidates -> scorers, commander | scorers, commander |
//! | `packcell/decisions` | [`Decision`] | scorers -> commander, tools | commander |
//! | `packcell/commands` | [`PlaceCommand`] | commander -> arm (perception's stub) | arm |
//! | `packcell/motions` | [`MotionReport`] | arm -> commander | commander |
//! | `packcell/cycles` | [`CycleReport`] | commander -> tools | nobody: tools poll |
//! | `packcell/health` | [`Health`] | everybody -> tools | nobody: tools poll |
//! | `packcell/control` | [`Control`] | tools -> commander, `packcell up` | commander |
//! | `packcell/active` | [`Active`] | commander -> tools | nobody: tools poll |
//!
//! Every topic keeps its newest message for whoever comes late, and overflows by dropping the oldest message of the
//! reader that is slow: a writer never waits for a reader. A lost message shows as a gap in the header's sequence.

use std::marker::PhantomData;

use crate::{
    Active, Belief, BoxQueue, CandidateSet, Control, CycleReport, Decision, Health, Malformed, Message, MotionReport,
    PlaceCommand,
};

/// A stream of messages of one type.
#[derive(Debug)]
pub struct Topic<M> {
    /// Its name on the bus.
    pub name: &'static str,
    /// Processes that may publish at one time; one more is refused.
    pub publishers_max: usize,
    /// Messages kept for a reader that is behind.
    pub depth: usize,
    /// Whose bells a publication rings.
    pub wakes: &'static [Role],
    message: PhantomData<fn() -> M>,
}

/// What a process is for. Each role has one bell on which its processes sleep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Belt, containers, sensor and arm.
    Perception,
    /// Grid and box to candidate set.
    Candidates,
    /// Candidate set to decision.
    Scorer,
    /// Candidate set and decisions to command.
    Commander,
    /// Whoever watches or operates the cell.
    Tool,
}

/// Readers that a topic has room for: the cell's own, a second set of them while they are replaced, and tools.
pub const SUBSCRIBERS_MAX: usize = 16;

/// Processes that a topic has room for, dead ones that nobody has cleaned up included.
pub const NODES_MAX: usize = 48;

/// Scorer instances, `a` to `h`.
pub const SCORERS_MAX: usize = 8;

/// The grid we act on.
pub const BELIEF: Topic<Belief> = Topic::new("packcell/belief", 1, 1, &[]);
/// The box to place and the next ones.
pub const BOXES: Topic<BoxQueue> = Topic::new("packcell/boxes", 1, 1, &[Role::Candidates]);
/// Where the box could go. Two generators may run side by side.
pub const CANDIDATES: Topic<CandidateSet> = Topic::new("packcell/candidates", 2, 2, &[Role::Scorer, Role::Commander]);
/// What the scorers would do.
pub const DECISIONS: Topic<Decision> = Topic::new("packcell/decisions", SCORERS_MAX, 4, &[Role::Commander]);
/// What the arm is told to do.
pub const COMMANDS: Topic<PlaceCommand> = Topic::new("packcell/commands", 1, 2, &[Role::Perception]);
/// What the arm did.
pub const MOTIONS: Topic<MotionReport> = Topic::new("packcell/motions", 1, 2, &[Role::Commander]);
/// One box from observation to motion. Deep, because its readers poll.
pub const CYCLES: Topic<CycleReport> = Topic::new("packcell/cycles", 1, 1024, &[]);
/// What every process is doing.
pub const HEALTH: Topic<Health> = Topic::new("packcell/health", 24, 1, &[]);
/// What an operator asks for. One at a time: two swaps at once would undo each other.
pub const CONTROL: Topic<Control> = Topic::new("packcell/control", 1, 4, &[Role::Commander]);
/// Which scorer instance is obeyed.
pub const ACTIVE: Topic<Active> = Topic::new("packcell/active", 1, 1, &[]);

impl<M: Message> Topic<M> {
    const fn new(name: &'static str, publishers_max: usize, depth: usize, wakes: &'static [Role]) -> Self {
        Self { name, publishers_max, depth, wakes, message: PhantomData }
    }

    /// Shared memory that one publisher of the topic may come to use [bytes]: what every reader may hold or have
    /// waiting, and what it builds and keeps itself.
    #[must_use]
    pub const fn publisher_bytes(&self) -> usize {
        (SUBSCRIBERS_MAX * (self.depth + 2) + 2) * size_of::<M>()
    }
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 5] = [Self::Perception, Self::Candidates, Self::Scorer, Self::Commander, Self::Tool];

    /// The name of the role, which is also the name of its program.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Perception => "perception",
            Self::Candidates => "candidates",
            Self::Scorer => "scorer",
            Self::Commander => "commander",
            Self::Tool => "packcell",
        }
    }

    /// The name of the role's bell on the bus.
    #[must_use]
    pub fn bell(self) -> &'static str {
        match self {
            Self::Perception => "packcell/bell/perception",
            Self::Candidates => "packcell/bell/candidates",
            Self::Scorer => "packcell/bell/scorer",
            Self::Commander => "packcell/bell/commander",
            Self::Tool => "packcell/bell/tool",
        }
    }

    /// The number that stands for it on the wire.
    #[must_use]
    pub fn to_wire(self) -> u32 {
        match self {
            Self::Perception => 0,
            Self::Candidates => 1,
            Self::Scorer => 2,
            Self::Commander => 3,
            Self::Tool => 4,
        }
    }

    /// The role that the number stands for.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for none.
    pub fn from_wire(value: u32) -> Result<Self, Malformed> {
        let unknown = Malformed::Unknown { field: "role", value };
        Self::ALL.into_iter().find(|role| role.to_wire() == value).ok_or(unknown)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_cross_the_wire_unchanged() {
        for role in Role::ALL {
            assert_eq!(Role::from_wire(role.to_wire()), Ok(role));
        }
        assert!(Role::from_wire(5).is_err());
    }
}
