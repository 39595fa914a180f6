//! What is to happen to the cell, and when.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, bail};
use messages::topics::Role;
use packing::Draw;
use serde::{Deserialize, Serialize};

/// Purpose of the draws, which sets them apart from those of episodes.
const PURPOSE: u64 = 611;

/// The mix that is used unless another is named.
const DEFAULT: &str = include_str!("default_faults.toml");

/// What can happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Kind {
    /// Another scorer is made the active one.
    Swap,
    /// SIGKILL.
    Kill,
    /// SIGSTOP, and SIGCONT later.
    Freeze,
    /// Wrong messages on a topic.
    Rubbish,
    /// Frozen two thirds of the time.
    Slow,
    /// Somebody else needs every processor.
    Hog,
    /// The journal cannot grow.
    FullDisk,
}

/// One line of a fault file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    kind: Kind,
    target: Option<String>,
    first_boxes: Option<u64>,
    every_boxes: Option<u64>,
    first_s: Option<f64>,
    every_s: Option<f64>,
    #[serde(default)]
    for_ms: u64,
    /// 0 for without end.
    #[serde(default)]
    times: u64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    fault: Vec<Line>,
}

/// One thing that is to happen now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Fault {
    pub(crate) kind: Kind,
    pub(crate) target: Target,
    pub(crate) for_ms: u64,
}

/// What it happens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// The process of this role; of scorers, the active one.
    Process(Role),
    /// The topic `packcell/decisions`.
    Decisions,
    /// The topic `packcell/candidates`.
    Candidates,
    /// The whole machine.
    Machine,
}

/// What happens when.
#[derive(Debug)]
pub(crate) struct Schedule {
    rules: Vec<Rule>,
    draw: Draw,
}

#[derive(Debug)]
struct Rule {
    fault: Fault,
    beat: Beat,
    every: f64,
    next: f64,
    /// How often it may still happen; nothing for without end.
    left: Option<u64>,
}

/// What a rule counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Beat {
    Boxes,
    Seconds,
}

impl Kind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Swap => "swap",
            Self::Kill => "kill",
            Self::Freeze => "freeze",
            Self::Rubbish => "rubbish",
            Self::Slow => "slow",
            Self::Hog => "hog",
            Self::FullDisk => "full-disk",
        }
    }

    /// Whether it can be done to a cell that somebody else supervises.
    fn is_possible_from_outside(self) -> bool {
        matches!(self, Self::Swap | Self::Rubbish | Self::Hog)
    }

    fn lasts(self) -> bool {
        !matches!(self, Self::Swap | Self::Kill)
    }

    fn target(self, named: Option<&str>) -> anyhow::Result<Target> {
        let role = |name: &str| Role::ALL.into_iter().find(|role| *role != Role::Tool && role.name() == name);
        Ok(match (self, named) {
            (Self::Kill | Self::Freeze, Some(name)) => Target::Process(role(name).with_context(|| {
                format!("target {name:?} is none: name perception, candidates, scorer or commander")
            })?),
            (Self::Slow | Self::Swap, None | Some("scorer")) => Target::Process(Role::Scorer),
            (Self::Rubbish, Some("decisions")) => Target::Decisions,
            (Self::Rubbish, Some("candidates")) => Target::Candidates,
            (Self::Hog, None) => Target::Machine,
            (Self::FullDisk, None | Some("commander")) => Target::Process(Role::Commander),
            (Self::Rubbish, _) => bail!("rubbish needs target = \"decisions\" or \"candidates\""),
            (Self::Kill | Self::Freeze, None) => bail!("{} needs a target", self.name()),
            (_, Some(name)) => bail!("{} has no target {name:?}", self.name()),
        })
    }
}

impl Target {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Process(role) => role.name(),
            Self::Decisions => "decisions",
            Self::Candidates => "candidate sets",
            Self::Machine => "machine",
        }
    }
}

impl Schedule {
    /// The schedule that is named: `default`, `none`, or a file.
    pub(crate) fn named(name: &str, seed: u64) -> anyhow::Result<Self> {
        match name {
            "none" => Ok(Self { rules: Vec::new(), draw: Draw::new(PURPOSE, seed, 0) }),
            "default" => Self::parse(DEFAULT, seed).context("the default faults"),
            path => {
                let text =
                    fs::read_to_string(Path::new(path)).with_context(|| format!("cannot read --faults {path}"))?;
                Self::parse(&text, seed).with_context(|| format!("--faults {path}"))
            }
        }
    }

    fn parse(text: &str, seed: u64) -> anyhow::Result<Self> {
        let file: File = toml::from_str(text).map_err(|error| anyhow::anyhow!("{}", error.to_string().trim()))?;
        let mut draw = Draw::new(PURPOSE, seed, 0);
        let mut rules = Vec::new();
        for (number, line) in (1..).zip(file.fault) {
            rules.push(Rule::of(line, &mut draw).with_context(|| format!("[[fault]] number {number}"))?);
        }
        Ok(Self { rules, draw })
    }

    /// Fails if something is planned that only a cell's own supervisor may do.
    pub(crate) fn check_from_outside(&self) -> anyhow::Result<()> {
        match self.rules.iter().find(|rule| !rule.fault.kind.is_possible_from_outside()) {
            Some(rule) => bail!(
                "{} is not done to an attached cell, which others supervise: only swap, rubbish and hog are",
                rule.fault.kind.name()
            ),
            None => Ok(()),
        }
    }

    /// What is to happen after so many boxes and seconds, one fault at a time.
    pub(crate) fn due(&mut self, boxes: u64, seconds: f64) -> Option<Fault> {
        let reached = |rule: &Rule| if rule.beat == Beat::Boxes { boxes as f64 } else { seconds };
        let rule = self.rules.iter_mut().find(|rule| rule.left != Some(0) && reached(rule) >= rule.next)?;
        // Counted from now: a cell that was away is not punished with everything that it missed.
        rule.next = reached(rule) + rule.pause(&mut self.draw);
        rule.left = rule.left.map(|left| left - 1);
        Some(rule.fault.clone())
    }

    /// Whether everything has happened.
    pub(crate) fn is_over(&self) -> bool {
        self.rules.iter().all(|rule| rule.left == Some(0))
    }

    /// Whether anything is planned at all.
    pub(crate) fn is_empty(&self) -> bool {
        self.rules.is_empty()
    }
}

impl Rule {
    fn of(line: Line, draw: &mut Draw) -> anyhow::Result<Self> {
        let fault = Fault { kind: line.kind, target: line.kind.target(line.target.as_deref())?, for_ms: line.for_ms };
        if line.kind.lasts() != (line.for_ms > 0) {
            let wants = if line.kind.lasts() { "needs" } else { "has no" };
            bail!("{} {wants} for_ms", line.kind.name());
        }
        let (beat, first, every) = match line {
            Line { every_boxes: Some(every), every_s: None, first_s: None, first_boxes, .. } => {
                (Beat::Boxes, first_boxes.map(|boxes| boxes as f64), every as f64)
            }
            Line { every_s: Some(every), every_boxes: None, first_boxes: None, first_s, .. } => {
                (Beat::Seconds, first_s, every)
            }
            _ => bail!("say either every_boxes (and first_boxes) or every_s (and first_s)"),
        };
        if !(every.is_finite() && every > 0.0 && first.is_none_or(f64::is_finite)) {
            bail!("an interval must be a number above 0");
        }
        let mut rule = Self { fault, beat, every, next: 0.0, left: (line.times > 0).then_some(line.times) };
        rule.next = first.unwrap_or_else(|| rule.pause(draw));
        Ok(rule)
    }

    fn pause(&self, draw: &mut Draw) -> f64 {
        self.every * (0.5 + draw.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_mix_is_a_schedule_and_has_everything() {
        let schedule = Schedule::named("default", 1).unwrap();
        let kinds: std::collections::BTreeSet<_> = schedule.rules.iter().map(|rule| rule.fault.kind).collect();
        assert_eq!(kinds.len(), 7);
        assert!(schedule.check_from_outside().unwrap_err().to_string().contains("others supervise"));
        assert!(!schedule.is_over() && Schedule::named("none", 1).unwrap().is_over());
    }

    #[test]
    fn a_rule_comes_at_its_beat_and_ends() {
        let text = "[[fault]]\nkind = \"kill\"\ntarget = \"scorer\"\nfirst_boxes = 10\nevery_boxes = 100\ntimes = 3";
        let happened = |seed| {
            let mut schedule = Schedule::parse(text, seed).unwrap();
            let at: Vec<u64> = (0..1000).filter(|&boxes| schedule.due(boxes, 0.0).is_some()).collect();
            assert!(schedule.is_over());
            at
        };
        let at = happened(1);
        assert!(at.len() == 3 && at[0] == 10 && at.windows(2).all(|pair| (50..=151).contains(&(pair[1] - pair[0]))));
        assert_eq!(happened(1), at, "the same seed gives the same schedule");
        assert_ne!(happened(2), at);
    }

    #[test]
    fn a_file_that_means_nothing_is_refused() {
        for (text, says) in [
            ("fault = 3", "invalid type"),
            ("[[fault]]\nkind = \"flood\"\nevery_s = 1", "flood"),
            ("[[fault]]\nkind = \"kill\"\nevery_s = 1", "needs a target"),
            ("[[fault]]\nkind = \"kill\"\ntarget = \"arm\"\nevery_s = 1", "name perception"),
            ("[[fault]]\nkind = \"hog\"\nevery_s = 1", "needs for_ms"),
            ("[[fault]]\nkind = \"swap\"\nevery_s = 1\nfor_ms = 5", "has no for_ms"),
            ("[[fault]]\nkind = \"swap\"\nevery_s = 1\nevery_boxes = 5", "either every_boxes"),
            ("[[fault]]\nkind = \"swap\"\nevery_s = 0.0", "above 0"),
            ("[[fault]]\nkind = \"rubbish\"\ntarget = \"belief\"\nfor_ms = 1\nevery_s = 1", "decisions"),
        ] {
            let message = format!("{:#}", Schedule::parse(text, 1).unwrap_err());
            assert!(message.contains(says), "{text}: {message}");
        }
        let message = format!("{:#}", Schedule::named("/none/faults.toml", 1).unwrap_err());
        assert!(message.contains("/none/faults.toml"), "{message}");
    }
}
