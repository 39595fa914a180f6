//! What a box may stand on, and how near to anything.

use crate::{BoxSpec, ContainerSize, Extent, Support};

/// The rules of a cell beyond its walls. The default is the paper's: boxes stand flush, on level and full support.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rules {
    /// How much of a base must rest on something.
    pub support: Support,
    /// What a box keeps free on each of its four sides [mm]: towards a wall once, towards another box twice, for both
    /// keep it. Whoever sets boxes down with errors of at most so much then touches nothing.
    pub clearance_mm: u16,
    /// Heights that differ by no more than this count as level [mm], in whole grid cells: less than a cell is none.
    pub level_mm: u16,
}

impl Rules {
    /// The room that the box takes at yaw 0 of such a container, in whole grid cells: its footprint grown by the clearance
    /// on every side, partial cells rounded up. It stands in the middle of it.
    ///
    /// A box that fits between the walls, but not with its clearance, gets all the room between them: there is no
    /// neighbour on these sides, and a wall guides.
    #[must_use]
    pub fn extent(&self, spec: &BoxSpec, size: ContainerSize) -> Extent {
        let (bare, [length_mm, breadth_mm, _]) = (spec.extent(size.cell_mm()), spec.size_mm());
        let grown = |side_mm: u32| (side_mm + 2 * u32::from(self.clearance_mm)).div_ceil(size.cell_mm());
        // A box of BOX_SIDE_MM_MAX with the largest clearance has more cells than any container.
        let cells = |side_mm: u32| u16::try_from(grown(side_mm)).unwrap_or(u16::MAX);
        let grown = Extent { length: cells(length_mm), breadth: cells(breadth_mm), ..bare };
        if self.clearance_mm == 0 || size.admits(grown) {
            return grown;
        }
        let within = |length: u16, breadth: u16| {
            let fits = bare.length <= length && bare.breadth <= breadth;
            fits.then_some(Extent { length: grown.length.min(length), breadth: grown.breadth.min(breadth), ..bare })
        };
        let (length, breadth) = (size.length(), size.breadth());
        within(length, breadth).or_else(|| within(breadth, length)).unwrap_or(grown)
    }

    /// The largest difference of heights that counts as level [cells].
    pub(crate) fn level_cells(&self, cell_mm: u32) -> u16 {
        (u32::from(self.level_mm) / cell_mm) as u16
    }
}

impl From<Support> for Rules {
    fn from(support: Support) -> Self {
        Self { support, ..Self::default() }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Grid, Placement, Yaw, corner_candidates};

    #[test]
    fn clearance_grows_the_footprint_and_not_the_height() {
        let spec = BoxSpec::new(1, [101, 96, 50]).unwrap();
        let size = ContainerSize::PAPER;
        let extent = |clearance_mm| Rules { clearance_mm, ..Rules::default() }.extent(&spec, size);
        assert_eq!(extent(0), spec.extent(10));
        assert_eq!(extent(2), Extent { length: 11, breadth: 10, height: 5 });
        assert_eq!(extent(5), Extent { length: 12, breadth: 11, height: 5 });
        assert_eq!(extent(10), Extent { length: 13, breadth: 12, height: 5 });
        let largest = BoxSpec::new(1, [10_000; 3]).unwrap();
        let size = ContainerSize::new(9, 9, 9, 1).unwrap();
        assert_eq!(Rules { clearance_mm: u16::MAX, ..Rules::default() }.extent(&largest, size).length, u16::MAX);
    }

    #[test]
    fn a_box_as_wide_as_the_container_gets_what_there_is() {
        let extent = |sides_mm: [u32; 3]| {
            let rules = Rules { clearance_mm: 10, ..Rules::default() };
            let extent = rules.extent(&BoxSpec::new(1, sides_mm).unwrap(), ContainerSize::PAPER);
            (extent.length, extent.breadth)
        };
        assert_eq!(extent([450, 300, 100]), (47, 32), "it fits when it is turned");
        assert_eq!(extent([450, 500, 100]), (45, 52));
        assert_eq!(extent([800, 445, 100]), (80, 45), "turned");
        assert_eq!(extent([451, 451, 100]), (48, 48), "it fits nowhere, clearance or not");
    }

    #[test]
    fn less_than_a_cell_is_no_tolerance() {
        let level_cells = |level_mm, cell_mm| Rules { level_mm, ..Rules::default() }.level_cells(cell_mm);
        assert_eq!([level_cells(9, 10), level_cells(10, 10), level_cells(9, 2)], [0, 1, 4]);
    }

    /// A box where its middle is the middle of its cells: low corner and high corner along `i` and `j`, in half mm.
    fn footprint(spec: &BoxSpec, extent: Extent, placement: Placement, cell_mm: u32) -> [(u32, u32); 2] {
        let room = extent.turned(placement.yaw);
        let [mut length_mm, mut breadth_mm, _] = spec.size_mm();
        if placement.yaw == Yaw::Deg90 {
            std::mem::swap(&mut length_mm, &mut breadth_mm);
        }
        let side = |first: u16, cells: u16, side_mm: u32| {
            let middle = (2 * u32::from(first) + u32::from(cells)) * cell_mm;
            (middle - side_mm, middle + side_mm)
        };
        [side(placement.i, room.length, length_mm), side(placement.j, room.breadth, breadth_mm)]
    }

    proptest! {
        /// In millimetres, between all pairs and to all walls.
        #[test]
        fn boxes_keep_their_distance(
            sizes in prop::collection::vec((10u32..120, 10u32..120), 1..12), clearance_mm in 0u16..25, picks in prop::collection::vec(0usize..1000, 12),
        ) {
            let size = ContainerSize::new(30, 25, 9, 10).unwrap();
            let rules = Rules { clearance_mm, ..Rules::default() };
            let mut grid = Grid::with_rules(size, 1, rules).unwrap();
            let (mut candidates, mut placed) = (Vec::new(), Vec::<[(u32, u32); 2]>::new());
            for ((l, b), pick) in sizes.into_iter().zip(picks) {
                // As high as the container, so that no box stands on another.
                let spec = BoxSpec::new(1, [l, b, 90]).unwrap();
                let extent = grid.extent(&spec);
                corner_candidates(&grid, extent, &crate::WalleWeights::PAPER, &mut candidates);
                if candidates.is_empty() {
                    continue;
                }
                let placement = candidates[pick % candidates.len()].placement;
                grid.place(&spec, placement).unwrap();
                let sides = footprint(&spec, extent, placement, 10);
                let gap = 2 * u32::from(clearance_mm);
                // No box here is so wide that it may come nearer to a wall.
                for (&(low, high), limit) in sides.iter().zip([2 * 300, 2 * 250]) {
                    prop_assert!(low >= gap && high + gap <= limit, "the wall is nearer than {clearance_mm} mm");
                }
                for other in &placed {
                    let apart = |axis: usize| sides[axis].0 >= other[axis].1 + 2 * gap || other[axis].0 >= sides[axis].1 + 2 * gap;
                    prop_assert!(apart(0) || apart(1), "{sides:?} and {other:?} are nearer than twice {clearance_mm} mm");
                }
                placed.push(sides);
            }
        }
    }
}
