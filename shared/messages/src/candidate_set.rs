//! `packcell/candidates`: where the current box could go.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use packing::{BoxSpec, Candidate};

use crate::box_queue::check_upcoming;
use crate::header::impl_message;
use crate::{Header, Malformed, UPCOMING_MAX, WireBox, WirePlacement};

/// Most candidates of one box. Sixteen open paper containers offer some hundreds.
pub const CANDIDATES_MAX: usize = 4096;

/// The candidates of one box on one revision of the belief, in the order `packing` generates them.
///
/// Equal inputs give equal sets, so that two generators may run side by side. Empty means the box fits nowhere.
#[derive(Clone, Copy, Debug, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/CandidateSet/v1")]
#[repr(C)]
pub struct CandidateSet {
    /// See [`Header`].
    pub header: Header,
    /// When the generator received the box [ns, CLOCK_MONOTONIC].
    pub received_ns: u64,
    /// When perception published the box [ns, CLOCK_MONOTONIC].
    pub boxes_stamp_ns: u64,
    /// The revision of the belief for which the candidates hold.
    pub revision: u64,
    /// The box to place.
    pub current: WireBox,
    /// The boxes behind it, nearest first.
    pub upcoming: [WireBox; UPCOMING_MAX],
    /// How many of `upcoming` are known.
    pub upcoming_count: u32,
    /// How many of `candidates` there are.
    pub count: u32,
    /// How many more were found: the worst by WallE's score, for which there was no room.
    pub left_out: u32,
    /// Zero.
    pub reserved: u32,
    /// A digest of the box, the revision and the candidates, by which a decision names the set it answers.
    pub digest: u64,
    /// Those beyond `count` mean nothing.
    pub candidates: [WireCandidate; CANDIDATES_MAX],
}

/// One candidate, with WallE's score beside it for whoever has no better opinion in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[type_name("packcell/WireCandidate/v1")]
#[repr(C)]
pub struct WireCandidate {
    /// Where and how.
    pub placement: WirePlacement,
    /// WallE's stability score, finite; larger is better.
    pub walle: f32,
}

const _: () = assert!(size_of::<WireCandidate>() == 16);
const _: () = assert!(size_of::<CandidateSet>() == 32 + 24 + 24 + 8 * 24 + 16 + 8 + 4096 * 16);

impl_message!(CandidateSet);

impl CandidateSet {
    /// Writes the candidates and their digest. Beyond [`CANDIDATES_MAX`] the worst by WallE's score are left out,
    /// the later ones first among equals, and counted. Box and revision must stand already.
    pub fn write_candidates(&mut self, candidates: &[Candidate]) {
        let kept = candidates.len().min(CANDIDATES_MAX);
        self.left_out = (candidates.len() - kept) as u32;
        self.count = kept as u32;
        self.reserved = 0;
        if kept == candidates.len() {
            for (wire, candidate) in self.candidates.iter_mut().zip(candidates) {
                *wire = candidate.into();
            }
        } else {
            let mut best: Vec<usize> = (0..candidates.len()).collect();
            best.sort_by(|&a, &b| candidates[b].walle.total_cmp(&candidates[a].walle));
            best.truncate(kept);
            best.sort_unstable();
            for (wire, index) in self.candidates.iter_mut().zip(best) {
                *wire = (&candidates[index]).into();
            }
        }
        self.digest = self.computed_digest();
    }

    /// The candidates as domain values, checked, into `candidates`, which is cleared first.
    ///
    /// # Errors
    /// [`Malformed`] at the first thing that no correct generator sends; `candidates` is then empty.
    pub fn read_candidates(&self, candidates: &mut Vec<Candidate>) -> Result<(), Malformed> {
        candidates.clear();
        let too_many = Malformed::Count { what: "candidates", count: self.count, limit: CANDIDATES_MAX };
        let wire = self.candidates.get(..self.count as usize).ok_or(too_many)?;
        if self.digest != self.computed_digest() {
            return Err(Malformed::Digest);
        }
        for (index, candidate) in wire.iter().enumerate() {
            match candidate.check(index) {
                Ok(candidate) => candidates.push(candidate),
                Err(malformed) => {
                    candidates.clear();
                    return Err(malformed);
                }
            }
        }
        Ok(())
    }

    /// The box to place.
    ///
    /// # Errors
    /// [`Malformed::Box`].
    pub fn spec(&self) -> Result<BoxSpec, Malformed> {
        self.current.try_into()
    }

    /// The boxes behind it, nearest first.
    ///
    /// # Errors
    /// [`Malformed`] if there are too many or one has no valid dimensions.
    pub fn known_upcoming(&self) -> Result<&[WireBox], Malformed> {
        check_upcoming(&self.upcoming, self.upcoming_count)
    }

    /// FNV-1a over the words that make two sets equal.
    fn computed_digest(&self) -> u64 {
        let head = [self.current.id, self.revision, u64::from(self.count), u64::from(self.left_out)];
        let listed = &self.candidates[..(self.count as usize).min(CANDIDATES_MAX)];
        let words = bytemuck::cast_slice::<WireCandidate, u32>(listed).chunks_exact(2);
        let listed = words.map(|pair| u64::from(pair[0]) | u64::from(pair[1]) << 32);
        head.into_iter().chain(listed).fold(0xcbf2_9ce4_8422_2325, |digest: u64, word| {
            (digest ^ word).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29)
        })
    }
}

impl WireCandidate {
    fn check(&self, index: usize) -> Result<Candidate, Malformed> {
        if self.walle.is_finite() {
            Ok(Candidate { placement: self.placement.try_into()?, walle: self.walle })
        } else {
            Err(Malformed::Score { index })
        }
    }
}

impl From<&Candidate> for WireCandidate {
    fn from(candidate: &Candidate) -> Self {
        Self { placement: candidate.placement.into(), walle: candidate.walle }
    }
}

#[cfg(test)]
mod tests {
    use packing::{Placement, Yaw};
    use proptest::prelude::*;

    use super::*;

    fn candidates(count: u16) -> Vec<Candidate> {
        let placement = |i| Placement { slot: 1, yaw: Yaw::Deg90, i, j: 2, base: 3 };
        (0..count).map(|i| Candidate { placement: placement(i), walle: f32::from(i % 100) }).collect()
    }

    fn set(candidates: &[Candidate]) -> Box<CandidateSet> {
        let mut set: Box<CandidateSet> = Box::new(Zeroable::zeroed());
        set.current = WireBox { id: 4, size_mm: [10, 20, 30], reserved: 0 };
        set.revision = 5;
        set.write_candidates(candidates);
        set
    }

    #[test]
    fn candidates_cross_the_wire_unchanged() {
        let (sent, mut received) = (candidates(300), Vec::new());
        set(&sent).read_candidates(&mut received).unwrap();
        assert_eq!(received, sent);
    }

    #[test]
    fn the_worst_are_left_out_and_counted() {
        let (sent, mut received) = (candidates(4100), Vec::new());
        let set = set(&sent);
        set.read_candidates(&mut received).unwrap();
        assert_eq!((set.count, set.left_out), (4096, 4));
        // Scores 0 to 99 come 41 times each: the four latest zeros go.
        let zeros = received.iter().filter(|c| c.walle == 0.0).map(|c| c.placement.i).max();
        assert_eq!(zeros, Some(3600));
        assert!(received.is_sorted_by_key(|c| c.placement.i), "the order is kept");
    }

    #[test]
    fn what_no_generator_sends_is_refused() {
        let mut received = candidates(1);
        let mut rubbish = set(&candidates(3));
        rubbish.candidates[1].walle = f32::NAN;
        assert_eq!(rubbish.read_candidates(&mut received), Err(Malformed::Digest));
        rubbish.digest = rubbish.computed_digest();
        assert_eq!(rubbish.read_candidates(&mut received), Err(Malformed::Score { index: 1 }));
        assert!(received.is_empty());
        rubbish.count = u32::MAX;
        assert!(matches!(rubbish.read_candidates(&mut received), Err(Malformed::Count { .. })));
    }

    #[test]
    fn sets_differ_in_their_digest() {
        let base = set(&candidates(3)).digest;
        assert_eq!(set(&candidates(3)).digest, base);
        assert_ne!(set(&candidates(2)).digest, base);
        let mut other = candidates(3);
        other[2].placement.j += 1;
        assert_ne!(set(&other).digest, base);
    }

    proptest! {
        #[test]
        fn no_bytes_make_a_reader_panic(word in any::<u64>(), count in any::<u32>(), digest in any::<bool>()) {
            let mut set: Box<CandidateSet> = Box::new(Zeroable::zeroed());
            bytemuck::cast_slice_mut::<CandidateSet, u64>(std::slice::from_mut(&mut set)).fill(word);
            set.count = count % 5000;
            if digest {
                set.digest = set.computed_digest();
            }
            let mut received = Vec::new();
            let result = set.read_candidates(&mut received);
            prop_assert!(result.is_ok() || received.is_empty());
            let _ = (set.spec(), set.known_upcoming());
        }
    }
}
