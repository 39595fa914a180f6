//! The letters of scorer instances.

use std::fmt::{Display, Formatter};
use std::str::FromStr;

use crate::Malformed;
use crate::topics::SCORERS_MAX;

/// One running scorer process: `a` to `h` for people, 0 to 7 on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Instance(u8);

/// A letter that names no instance.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no scorer instance {0:?}: use a letter from a to {last}", last = Instance::LAST)]
pub struct UnknownInstance(pub String);

impl Instance {
    const LAST: Self = Self(SCORERS_MAX as u8 - 1);

    /// All instances that there may be.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..=Self::LAST.0).map(Self)
    }

    /// The number that stands for it on the wire.
    #[must_use]
    pub fn to_wire(self) -> u32 {
        self.0.into()
    }

    /// The instance that the number stands for.
    ///
    /// # Errors
    /// [`Malformed::Unknown`] for a number that stands for none.
    pub fn from_wire(value: u32) -> Result<Self, Malformed> {
        let unknown = Malformed::Unknown { field: "instance", value };
        Self::all().find(|instance| instance.to_wire() == value).ok_or(unknown)
    }
}

impl Display for Instance {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", char::from(b'a' + self.0))
    }
}

impl FromStr for Instance {
    type Err = UnknownInstance;

    fn from_str(letter: &str) -> Result<Self, UnknownInstance> {
        Self::all().find(|instance| instance.to_string() == letter).ok_or_else(|| UnknownInstance(letter.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instances_have_letters_and_numbers() {
        assert_eq!(("a".parse(), "h".parse()), (Ok(Instance(0)), Ok(Instance(7))));
        for instance in Instance::all() {
            assert_eq!(Instance::from_wire(instance.to_wire()), Ok(instance));
        }
        assert!(Instance::from_wire(8).is_err());
        for wrong in ["i", "A", "", "ab", "1"] {
            let message = wrong.parse::<Instance>().unwrap_err().to_string();
            assert!(message.ends_with("use a letter from a to h"), "{message}");
        }
    }
}
