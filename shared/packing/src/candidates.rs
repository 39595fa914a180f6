//! Where a box could go: corner placements.

use crate::{Extent, Grid, Placement, Surface, WalleWeights, Yaw};

/// A feasible corner placement of one box, with WallE's opinion of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Where and how.
    pub placement: Placement,
    /// WallE's stability score, eq. (1); larger is better.
    pub walle: f32,
}

/// Collects the candidates of a box in all open containers, ordered by container (in the order they were opened),
/// yaw, `i` and `j`; if there are none, those of a fresh container.
///
/// A feasible placement is a candidate when at one of its four footprint corners both outward neighbours are a
/// wall or not level with the corner's cell, and that cell carries. Paper: "Conceptual
/// approach", figure 5. `candidates` is cleared first.
pub fn corner_candidates(grid: &Grid, extent: Extent, weights: &WalleWeights, candidates: &mut Vec<Candidate>) {
    candidates.clear();
    let mut places = Vec::new();
    for slot in grid.open_slots() {
        push_corners(grid, slot, extent, weights, &mut places, candidates);
    }
    if candidates.is_empty()
        && let Some(slot) = grid.fresh_slot()
    {
        push_corners(grid, slot, extent, weights, &mut places, candidates);
    }
}

/// A cell and the height of the base there: `(i, j, base)` [cells].
pub type Place = (u16, u16, u16);

/// Appends the candidates of one container; `places` is scratch.
pub(crate) fn push_corners(
    grid: &Grid,
    slot: u16,
    extent: Extent,
    weights: &WalleWeights,
    places: &mut Vec<Place>,
    candidates: &mut Vec<Candidate>,
) {
    let surface = grid.slots()[usize::from(slot)].surface();
    for &yaw in extent.yaws() {
        let turned = extent.turned(yaw);
        collect_places(surface, turned, places);
        candidates.extend(places.iter().map(|&(i, j, base)| {
            let walle = weights.score(surface, turned, i, j, base);
            Candidate { placement: Placement { slot, yaw, i, j, base }, walle }
        }));
    }
}

/// Calls `push` for the candidate places of a box of `extent` (yaw 0) in the container that stands in `slot`,
/// ordered by yaw, `i` and `j`, each once. `places` is scratch.
pub fn corner_places(
    surface: &Surface,
    slot: u16,
    extent: Extent,
    places: &mut Vec<Place>,
    mut push: impl FnMut(Placement),
) {
    for &yaw in extent.yaws() {
        collect_places(surface, extent.turned(yaw), places);
        places.iter().for_each(|&(i, j, base)| push(Placement { slot, yaw, i, j, base }));
    }
}

/// The candidate places of a box of `turned` extent, ordered by `i` and `j`, each once; `places` is cleared first.
fn collect_places(surface: &Surface, turned: Extent, places: &mut Vec<Place>) {
    places.clear();
    push_places(surface, turned, |i, j, base| places.push((i, j, base)));
    // The corners of one footprint find the same place up to four times.
    places.sort_unstable();
    places.dedup();
}

/// Calls `push` for every feasible place one of whose footprint corners lies on a corner of the surface.
fn push_places(surface: &Surface, turned: Extent, mut push: impl FnMut(u16, u16, u16)) {
    let (Some(i_last), Some(j_last)) =
        (surface.size().length().checked_sub(turned.length), surface.size().breadth().checked_sub(turned.breadth))
    else {
        return;
    };
    for corner in surface.corners() {
        let low_i = corner.towards_low_i.then_some(corner.i);
        let high_i = corner.towards_high_i.then(|| (corner.i + 1).checked_sub(turned.length)).flatten();
        let low_j = corner.towards_low_j.then_some(corner.j);
        let high_j = corner.towards_high_j.then(|| (corner.j + 1).checked_sub(turned.breadth)).flatten();
        for i in [low_i, high_i].into_iter().flatten().filter(|&i| i <= i_last) {
            for j in [low_j, high_j].into_iter().flatten().filter(|&j| j <= j_last) {
                if let Some(base) = surface.rest_inside(turned, usize::from(i), usize::from(j))
                    && surface.carries(corner.i, corner.j, base)
                {
                    push(i, j, base);
                }
            }
        }
    }
}

/// The definition, cell by cell, against which the fast method is held.
#[cfg(test)]
fn is_corner_place(surface: &Surface, turned: Extent, i: u16, j: u16, base: u16) -> bool {
    let size = surface.size();
    let height = |i: i32, j: i32| surface.row(i as usize)[j as usize];
    let level_cells = surface.rules().level_mm / size.cell_mm() as u16;
    let carries = |i: i32, j: i32| height(i, j) >= base.saturating_sub(level_cells);
    let differs = |(i, j): (i32, i32), corner: u16| {
        let inside = (0..i32::from(size.length())).contains(&i) && (0..i32::from(size.breadth())).contains(&j);
        !inside || height(i, j).abs_diff(corner) > level_cells
    };
    let (top, bottom) = (i32::from(i), i32::from(i + turned.length) - 1);
    let (left, right) = (i32::from(j), i32::from(j + turned.breadth) - 1);
    [(top, -1, left, -1), (top, -1, right, 1), (bottom, 1, left, -1), (bottom, 1, right, 1)].into_iter().any(
        |(i, outward_i, j, outward_j)| {
            let corner = height(i, j);
            carries(i, j) && differs((i + outward_i, j), corner) && differs((i, j + outward_j), corner)
        },
    )
}

/// The best place by score, with its score; the earliest of equals.
pub(crate) fn best_by_score(places: impl Iterator<Item = (f32, Placement)>) -> Option<(f32, Placement)> {
    let mut best: Option<(f32, Placement)> = None;
    for (score, placement) in places {
        if best.is_none_or(|(highest, _)| score > highest) {
            best = Some((score, placement));
        }
    }
    best
}

/// Every feasible placement in one container, ordered by yaw, `i` and `j`.
pub(crate) fn feasible_places(grid: &Grid, slot: u16, extent: Extent, yaws: &[Yaw]) -> impl Iterator<Item = Placement> {
    let surface = grid.slots()[usize::from(slot)].surface();
    yaws.iter().flat_map(move |&yaw| {
        surface.feasible(extent.turned(yaw)).map(move |(i, j, base)| Placement { slot, yaw, i, j, base })
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{BoxSpec, ContainerSize, Rules, Support};

    fn candidates(grid: &Grid, extent: Extent) -> Vec<Candidate> {
        let mut candidates = Vec::new();
        corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
        candidates
    }

    #[test]
    fn an_empty_container_offers_four_corners_per_yaw() {
        let grid = Grid::new(ContainerSize::PAPER, 2).unwrap();
        let found = candidates(&grid, Extent { length: 20, breadth: 30, height: 10 });
        let places: Vec<_> = found.iter().map(|c| (c.placement.yaw, c.placement.i, c.placement.j)).collect();
        let (a, b) = (Yaw::Deg0, Yaw::Deg90);
        assert_eq!(
            places,
            [(a, 0, 0), (a, 0, 50), (a, 25, 0), (a, 25, 50), (b, 0, 0), (b, 0, 60), (b, 15, 0), (b, 15, 60)]
        );
        assert!(found.iter().all(|c| c.placement.slot == 0), "one fresh container is enough");
    }

    /// A 2 x 2 box in the corner of a 5 x 5 floor, and a 1 x 1 box to come: on top of the box (its 4 corners),
    /// beside it (2 inner corners) and in the 3 free corners of the container, which are 9 of 25 cells.
    #[test]
    fn corners_of_the_loaded_structure_count() {
        let mut grid = Grid::new(ContainerSize::new(5, 5, 5, 10).unwrap(), 1).unwrap();
        let first = Placement { slot: 0, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 };
        grid.place(&BoxSpec::new(1, [20, 20, 10]).unwrap(), first).unwrap();
        let found = candidates(&grid, Extent { length: 1, breadth: 1, height: 1 });
        let places: Vec<_> = found.iter().map(|c| (c.placement.i, c.placement.j, c.placement.base)).collect();
        assert_eq!(
            places,
            [(0, 0, 1), (0, 1, 1), (0, 2, 0), (0, 4, 0), (1, 0, 1), (1, 1, 1), (2, 0, 0), (4, 0, 0), (4, 4, 0)]
        );
    }

    #[test]
    fn a_box_that_fits_nowhere_has_no_candidates() {
        let grid = Grid::new(ContainerSize::new(5, 5, 5, 10).unwrap(), 3).unwrap();
        assert!(candidates(&grid, Extent { length: 1, breadth: 1, height: 6 }).is_empty());
        assert!(candidates(&grid, Extent { length: 6, breadth: 1, height: 1 }).is_empty());
    }

    prop_compose! {
        /// A grid of three small containers with random boxes in the first two.
        pub(crate) fn arb_grid()(l in 1u16..8, b in 1u16..8, h in 1u16..8, partial in any::<bool>(), level in 0u16..3, clearance_mm in 0u16..6)(
            drops in prop::collection::vec((0u16..2, 1u32..6, 1u32..6, 1u32..4, 0..l, 0..b), 0..24),
            size in Just(ContainerSize::new(l, b, h, 10).unwrap()),
            support in Just(if partial { Support::Partial } else { Support::Full }),
            (level_mm, clearance_mm) in Just((10 * level, clearance_mm)),
        ) -> Grid {
            let mut grid = Grid::with_rules(size, 3, Rules { support, level_mm, clearance_mm }).unwrap();
            for (slot, l, b, h, i, j) in drops {
                let spec = BoxSpec::new(1, [l * 10, b * 10, h * 10]).unwrap();
                let surface = grid.slots()[usize::from(slot)].surface();
                if let Ok(base) = surface.rest(grid.extent(&spec), i, j) {
                    grid.place(&spec, Placement { slot, yaw: Yaw::Deg0, i, j, base }).unwrap();
                }
            }
            grid
        }
    }

    proptest! {
        #[test]
        fn fast_candidates_equal_the_definition(grid in arb_grid(), length in 1u16..8, breadth in 1u16..8, height in 1u16..8) {
            let extent = Extent { length, breadth, height };
            let by_definition = |slot: u16| {
                let surface = grid.slots()[usize::from(slot)].surface();
                let is_corner = move |p: &Placement| is_corner_place(surface, extent.turned(p.yaw), p.i, p.j, p.base);
                feasible_places(&grid, slot, extent, extent.yaws()).filter(is_corner).collect::<Vec<_>>()
            };
            let mut expected: Vec<_> = grid.open_slots().flat_map(by_definition).collect();
            if expected.is_empty() {
                expected = grid.fresh_slot().into_iter().flat_map(by_definition).collect();
            }
            let found = candidates(&grid, extent);
            prop_assert_eq!(found.iter().map(|c| c.placement).collect::<Vec<_>>(), expected);
            for candidate in found {
                prop_assert_eq!(grid.check(extent, candidate.placement), Ok(()));
            }
        }
    }
}
