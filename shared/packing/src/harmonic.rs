//! Harmonic columns, and a place at random: the two ends of the baselines.

use crate::candidates::push_corners;
use crate::{ContainerOrder, ContainerSize, Draw, Extent, Grid, Placement, Surface, WalleWeights};

/// A runnable relative of the harmonic algorithms, whose published form is one-dimensional.
///
/// A footprint `l x b` has the class `(floor(L / l), floor(B / b))`. Boxes of one class share columns of
/// `L / class` by `B / class` cells on the floor of a container; in a column every box stands inside the top of the
/// one below it. A box goes into the first column of its class that has the height for it, then into a new column in
/// the first open container with floor left, then into a fresh container; yaw 0 before yaw 90 each time.
///
/// It packs by its own columns: use one for one episode, and place what it chooses.
#[derive(Clone, Debug, Default)]
pub struct HarmonicColumns {
    floors: Vec<Floor>,
}

/// The columns of one container.
#[derive(Clone, Debug)]
struct Floor {
    container: u32,
    slot: u16,
    /// One cell high, and full where a column has been laid out.
    reserved: Surface,
    columns: Vec<Column>,
}

#[derive(Clone, Debug)]
struct Column {
    class: [u16; 2],
    i: u16,
    j: u16,
    top: Extent,
    height: u16,
}

impl HarmonicColumns {
    /// Where the box of `extent` (yaw 0) should go; nothing if it fits nowhere.
    pub fn choose(&mut self, grid: &Grid, extent: Extent) -> Option<Placement> {
        self.floors.retain(|floor| grid.slots()[usize::from(floor.slot)].container() == floor.container);
        self.on_a_column(grid, extent).or_else(|| self.on_the_floor(grid, extent)).or_else(|| {
            let slot = grid.fresh_slot()?;
            let container = grid.slots()[usize::from(slot)].container();
            self.floors.retain(|floor| floor.slot != slot);
            let size = grid.size();
            let flat = ContainerSize::new(size.length(), size.breadth(), 1, size.cell_mm()).ok()?;
            self.floors.push(Floor { container, slot, reserved: Surface::empty(flat), columns: Vec::new() });
            self.on_the_floor(grid, extent)
        })
    }

    fn on_a_column(&mut self, grid: &Grid, extent: Extent) -> Option<Placement> {
        for &yaw in extent.yaws() {
            let turned = extent.turned(yaw);
            let class = class(grid, turned);
            for floor in &mut self.floors {
                let fits = |column: &&mut Column| {
                    Some(column.class) == class
                        && turned.length <= column.top.length
                        && turned.breadth <= column.top.breadth
                        && u32::from(column.height) + u32::from(turned.height) <= u32::from(grid.size().height())
                };
                if let Some(column) = floor.columns.iter_mut().find(fits) {
                    let placement = Placement { slot: floor.slot, yaw, i: column.i, j: column.j, base: column.height };
                    column.top = turned;
                    column.height += turned.height;
                    return Some(placement);
                }
            }
        }
        None
    }

    fn on_the_floor(&mut self, grid: &Grid, extent: Extent) -> Option<Placement> {
        let size = grid.size();
        for &yaw in extent.yaws() {
            let turned = extent.turned(yaw);
            let Some(class) = class(grid, turned) else { continue };
            let column = Extent { length: size.length() / class[0], breadth: size.breadth() / class[1], height: 1 };
            for floor in &mut self.floors {
                let free = floor.reserved.feasible(column).next();
                if let Some((i, j, _)) = free
                    && turned.height <= size.height()
                    && floor.reserved.place(column, i, j).is_ok()
                {
                    floor.columns.push(Column { class, i, j, top: turned, height: turned.height });
                    return Some(Placement { slot: floor.slot, yaw, i, j, base: 0 });
                }
            }
        }
        None
    }
}

/// How many of the footprint stand beside each other along `i` and along `j`; nothing if it is too long for one.
fn class(grid: &Grid, turned: Extent) -> Option<[u16; 2]> {
    let class = [grid.size().length() / turned.length, grid.size().breadth() / turned.breadth];
    (!class.contains(&0)).then_some(class)
}

/// A place drawn uniformly from the corner candidates, of the first container that has any or of all open ones.
pub fn random_place(order: ContainerOrder, grid: &Grid, extent: Extent, draw: &mut Draw) -> Option<Placement> {
    let mut candidates = Vec::new();
    for slot in grid.open_slots() {
        push_corners(grid, slot, extent, &WalleWeights::PAPER, &mut Vec::new(), &mut candidates);
        if order == ContainerOrder::FirstThatFits && !candidates.is_empty() {
            break;
        }
    }
    if candidates.is_empty() {
        push_corners(grid, grid.fresh_slot()?, extent, &WalleWeights::PAPER, &mut Vec::new(), &mut candidates);
    }
    let drawn = (!candidates.is_empty()).then(|| draw.below(candidates.len() as u64))?;
    Some(candidates[drawn as usize].placement)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BoxSpec, ClosePolicy, Environment, Recipe, Split, Step};

    /// A 4 x 6 floor of height 5, and boxes of 2 x 2 (class 2, 3), of 1 x 2 (class 4, 3) and of 3 x 3 (class 1, 2).
    #[test]
    fn every_class_has_its_own_columns() {
        let mut environment =
            Environment::new(ContainerSize::new(4, 6, 5, 10).unwrap(), 2, ClosePolicy::Never).unwrap();
        let mut columns = HarmonicColumns::default();
        let mut pack = |size_mm| {
            let spec = BoxSpec::new(0, size_mm).unwrap();
            match environment.pack(&spec, |grid, extent| columns.choose(grid, extent)).unwrap() {
                Step::Placed(Placement { slot, i, j, base, .. }) => Some((slot, i, j, base)),
                Step::SetAside => None,
            }
        };
        assert_eq!(pack([20, 20, 30]), Some((0, 0, 0, 0)));
        assert_eq!(pack([10, 20, 20]), Some((0, 0, 2, 0)), "another class, beside the column of 2 x 2");
        assert_eq!(pack([20, 20, 20]), Some((0, 0, 0, 3)), "the first column has height for it");
        assert_eq!(pack([20, 20, 20]), Some((0, 0, 4, 0)), "it has no more");
        assert_eq!(pack([30, 30, 10]), Some((1, 0, 0, 0)), "its column of 4 x 3 has no floor left in the first");
        assert_eq!(pack([10, 20, 30]), Some((0, 0, 2, 2)));
        assert_eq!(pack([10, 10, 60]), None);
    }

    #[test]
    fn whole_episodes_are_packed_by_both() {
        let episode = Recipe::standard().episode(Split::Test, 1, 0).unwrap();
        for slots in [4, 16] {
            let mut columns = HarmonicColumns::default();
            let mut draw = Draw::new(0, 0, 0);
            let mut environments =
                [(); 2].map(|()| Environment::new(episode.container, slots, ClosePolicy::Oldest).unwrap());
            for spec in &episode.boxes {
                environments[0].pack(spec, |grid, extent| columns.choose(grid, extent)).unwrap();
                let random = |grid: &Grid, extent| random_place(ContainerOrder::AllOpen, grid, extent, &mut draw);
                environments[1].pack(spec, random).unwrap();
            }
            for environment in environments {
                assert_eq!(environment.placed().len(), episode.boxes.len());
            }
        }
    }

    #[test]
    fn a_random_place_is_any_candidate() {
        let grid = Grid::new(ContainerSize::new(4, 6, 5, 10).unwrap(), 2).unwrap();
        let mut draw = Draw::new(1, 2, 3);
        let extent = Extent { length: 1, breadth: 1, height: 1 };
        let mut drawn: Vec<_> = (0..100)
            .filter_map(|_| random_place(ContainerOrder::FirstThatFits, &grid, extent, &mut draw))
            .map(|place| (place.i, place.j))
            .collect();
        drawn.sort_unstable();
        drawn.dedup();
        assert_eq!(drawn, [(0, 0), (0, 5), (3, 0), (3, 5)]);
        let tall = Extent { height: 6, ..extent };
        assert_eq!(random_place(ContainerOrder::AllOpen, &grid, tall, &mut draw), None);
    }
}
