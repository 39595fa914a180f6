//! How much of a base must rest on something.

use std::fmt;
use std::str::FromStr;

/// What a box needs under its base.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Support {
    /// Everything: all cells under the base have one height. Paper: "Robot-implementability".
    #[default]
    Full,
    /// The rule of the single-container literature (Zhao et al., *Online 3D Bin Packing with Constrained Deep
    /// Reinforcement Learning*, 2021): at the highest level under the base lie over 95 % of its cells, or over 85 %
    /// and three of its corners, or over 60 % and all four. What an overhang covers is lost.
    Partial,
}

impl Support {
    /// The names of both rules, as [`FromStr`] reads them.
    pub const NAMES: [&str; 2] = ["full", "partial"];

    /// The partial rule, given the cells and corners of a base of `area` cells that lie at its highest level.
    pub(crate) fn suffices(level: u64, area: u64, level_corners: usize) -> bool {
        let needed_percent = match level_corners {
            4.. => 60,
            3 => 85,
            _ => 95,
        };
        level * 100 > area * needed_percent
    }
}

impl fmt::Display for Support {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Full => "full",
            Self::Partial => "partial",
        })
    }
}

impl FromStr for Support {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "full" => Ok(Self::Full),
            "partial" => Ok(Self::Partial),
            _ => Err(format!("there is no support rule {name:?}: use one of {}", Self::NAMES.join(", "))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_must_be_exceeded() {
        for (level, corners, suffices) in [
            (96, 0, true),
            (95, 2, false),
            (86, 3, true),
            (85, 3, false),
            (86, 2, false),
            (61, 4, true),
            (60, 4, false),
        ] {
            assert_eq!(Support::suffices(level, 100, corners), suffices, "{level} % and {corners} corners");
        }
    }
}
