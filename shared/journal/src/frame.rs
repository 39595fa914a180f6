//! Records as bytes: the one pair that writes and reads them.

use bincode::config::{Configuration, Limit, LittleEndian, Varint};

use crate::{Entry, State};

/// The first bytes of a journal: what it is, in words, and the version of all that follows.
pub const HEADER: &[u8] = b"packcell journal 1\n";

/// Most bytes that one entry may take; a length above it is damage.
const ENTRY_BYTES_MAX: usize = 512;

/// Bytes before an entry: its length, the complement of that, and its CRC-32, all little-endian.
const FRAME_HEAD_BYTES: usize = 8;

/// Most bytes that an entry takes in the file.
pub(crate) const FRAME_BYTES_MAX: usize = FRAME_HEAD_BYTES + ENTRY_BYTES_MAX;

/// How entries become bytes. A journal outlives the program that wrote it: a change here is a new [`HEADER`].
fn format() -> Configuration<LittleEndian, Varint, Limit<ENTRY_BYTES_MAX>> {
    bincode::config::standard().with_limit()
}

/// Everything that can be read from a journal.
#[derive(Clone, Debug, PartialEq)]
pub struct Contents {
    /// The entries up to the first that cannot be read.
    pub entries: Vec<Entry>,
    /// Bytes that they and the header take.
    pub whole_bytes: usize,
    /// What lies behind them.
    pub rest: Rest,
}

/// What lies behind the last whole entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rest {
    /// Nothing.
    Nothing,
    /// The beginning of one more entry, as a crash in the middle of a write leaves it.
    Cut,
    /// Bytes that no crash leaves: the file was damaged, or is no journal of this version.
    Damage,
}

impl Contents {
    /// What follows from all entries.
    #[must_use]
    pub fn state(&self) -> State {
        self.entries.iter().fold(State::default(), |state, entry| state.after(&entry.record))
    }
}

/// Appends an entry's frame to `bytes`.
pub fn encode(entry: &Entry, bytes: &mut Vec<u8>) {
    let head = bytes.len();
    bytes.extend([0; FRAME_HEAD_BYTES]);
    bincode::serde::encode_into_std_write(entry, bytes, format())
        .expect("memory takes what is written, and every entry is smaller than the limit");
    let body = head + FRAME_HEAD_BYTES;
    let (length, sum) = ((bytes.len() - body) as u16, crc32fast::hash(&bytes[body..]));
    bytes[head..head + 2].copy_from_slice(&length.to_le_bytes());
    bytes[head + 2..head + 4].copy_from_slice(&(!length).to_le_bytes());
    bytes[head + 4..body].copy_from_slice(&sum.to_le_bytes());
}

/// Reads a journal: never more than was written whole, whatever the bytes are.
///
/// An unreadable last entry counts as cut, not as damage: after a power cut the file may have its full length and
/// not all of its bytes.
#[must_use]
pub fn decode(bytes: &[u8]) -> Contents {
    if !bytes.starts_with(HEADER) {
        let rest = match bytes {
            [] => Rest::Nothing,
            _ if HEADER.starts_with(bytes) => Rest::Cut,
            _ => Rest::Damage,
        };
        return Contents { entries: Vec::new(), whole_bytes: 0, rest };
    }
    let (mut entries, mut at) = (Vec::new(), HEADER.len());
    loop {
        let whole_bytes = at;
        let rest = match next(&bytes[at..]) {
            Next::Entry { entry, bytes } => {
                entries.push(entry);
                at += bytes;
                continue;
            }
            Next::None(rest) => rest,
        };
        return Contents { entries, whole_bytes, rest };
    }
}

/// What bytes begin with.
pub(crate) enum Next {
    Entry { entry: Entry, bytes: usize },
    None(Rest),
}

/// The entry that the bytes behind a journal's header, or behind another entry, begin with.
pub(crate) fn next(bytes: &[u8]) -> Next {
    if bytes.is_empty() {
        return Next::None(Rest::Nothing);
    }
    let Some((head, behind)) = bytes.split_at_checked(FRAME_HEAD_BYTES) else { return Next::None(Rest::Cut) };
    let half = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
    let length = usize::from(half(0));
    if half(2) != !half(0) || length > ENTRY_BYTES_MAX {
        return Next::None(Rest::Damage);
    }
    let Some(body) = behind.get(..length) else { return Next::None(Rest::Cut) };
    let is_last = behind.len() == length;
    let unreadable = Next::None(if is_last { Rest::Cut } else { Rest::Damage });
    if crc32fast::hash(body) != u32::from_le_bytes([head[4], head[5], head[6], head[7]]) {
        return unreadable;
    }
    match bincode::serde::decode_from_slice(body, format()) {
        Ok((entry, used)) if used == length => Next::Entry { entry, bytes: FRAME_HEAD_BYTES + length },
        _ => unreadable,
    }
}

#[cfg(test)]
mod tests {
    use messages::MotionOutcome;
    use proptest::prelude::*;

    use super::*;
    use crate::record::intent;
    use crate::{Outcome, Record};

    fn entries() -> Vec<Entry> {
        let state = State { last: Some((intent(4), Some(MotionOutcome::Done))), active: 3 };
        let records = [
            Record::Carried(state),
            Record::Intent(intent(5)),
            Record::Outcome(Outcome { order: 5, outcome: MotionOutcome::Unreported }),
            Record::Active(2),
        ];
        (0..).zip(records).map(|(k, record)| Entry { unix_ms: 1_700_000_000_000 + k, record }).collect()
    }

    fn journal() -> Vec<u8> {
        let mut bytes = HEADER.to_vec();
        entries().iter().for_each(|entry| encode(entry, &mut bytes));
        bytes
    }

    #[test]
    fn what_is_written_is_read() {
        let bytes = journal();
        let contents = Contents { entries: entries(), whole_bytes: bytes.len(), rest: Rest::Nothing };
        assert_eq!(decode(&bytes), contents);
    }

    /// The bytes of version 1, for ever: a journal outlives the program that wrote it.
    #[test]
    fn the_format_is_fixed() {
        let mut bytes = Vec::new();
        encode(&Entry { unix_ms: 1, record: Record::Active(2) }, &mut bytes);
        assert_eq!(bytes, [3, 0, 0xfc, 0xff, 0x8b, 0xb0, 0xbb, 0x22, 1, 2, 2]);
    }

    #[test]
    fn a_cut_at_any_byte_loses_no_entry_before_it() {
        let bytes = journal();
        for length in 0..bytes.len() {
            let contents = decode(&bytes[..length]);
            assert!(contents.whole_bytes <= length);
            assert_eq!(contents.entries, entries()[..contents.entries.len()]);
            let is_whole = contents.whole_bytes == length;
            assert_eq!(contents.rest, if is_whole { Rest::Nothing } else { Rest::Cut }, "cut at {length}");
        }
    }

    #[test]
    fn a_flipped_bit_is_noticed_and_loses_no_entry_before_it() {
        let bytes = journal();
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut flipped = bytes.clone();
                flipped[at] ^= 1 << bit;
                let contents = decode(&flipped);
                assert!(contents.whole_bytes <= at, "byte {at} belongs to no entry that was read");
                assert_eq!(contents.entries, entries()[..contents.entries.len()]);
                let is_last = contents.entries.len() + 1 == entries().len();
                assert!(
                    contents.rest == Rest::Damage || contents.rest == Rest::Cut && is_last,
                    "{at}: {:?}",
                    contents.rest
                );
            }
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_reader_panic(bytes in prop::collection::vec(any::<u8>(), 0..600), is_headed in any::<bool>()) {
            let mut journal = if is_headed { HEADER.to_vec() } else { Vec::new() };
            journal.extend(&bytes);
            let contents = decode(&journal);
            prop_assert!(contents.whole_bytes <= journal.len());
        }
    }
}
