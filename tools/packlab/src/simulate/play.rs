//! The containers of a packing plan, played box by box.

use packing::{ContainerSize, Extent, Grid, PlaceError, PlacedBox, Rules};
use physical::{Fate, Imperfections, Lying, RigidContainer};

/// What a box stands on by the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Footing {
    /// All cells under its base have one height.
    Whole,
    /// Its four corners lie at the highest level under its base.
    FourCorners,
    /// Three of them do.
    ThreeCorners,
    /// Fewer.
    FewerCorners,
}

/// One box of a plan, and what became of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlayedBox {
    pub(crate) footing: Footing,
    /// It touched another box on its way down.
    pub(crate) collided: bool,
    /// At any time until its container was full.
    pub(crate) fate: Fate,
}

/// One container of a plan after all its boxes were set down.
#[derive(Clone, Debug)]
pub(crate) struct PlayedContainer {
    /// In the order of the plan.
    pub(crate) boxes: Vec<PlayedBox>,
    /// How those lie that are still in it.
    pub(crate) lying: Vec<Lying>,
    /// Boxes that shifted when it was shaken.
    pub(crate) shifted: usize,
    /// Boxes after which not all came to rest.
    pub(crate) restless: usize,
}

impl Footing {
    /// All of them, the firmest first.
    pub(crate) const ALL: [Self; 4] = [Self::Whole, Self::FourCorners, Self::ThreeCorners, Self::FewerCorners];

    /// As tables call it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Whole => "all of the base",
            Self::FourCorners => "part, four corners",
            Self::ThreeCorners => "part, three corners",
            Self::FewerCorners => "part, fewer corners",
        }
    }

    /// What a box of this extent (already turned) would stand on, its low corner being at this cell.
    fn of(heights: &[u16], size: ContainerSize, extent: Extent, [i, j]: [u16; 2]) -> Self {
        let height = |along: u16, across: u16| {
            heights[usize::from(i + along) * usize::from(size.breadth()) + usize::from(j + across)]
        };
        let cells = (0..extent.length).flat_map(|along| (0..extent.breadth).map(move |across| (along, across)));
        let top = cells.clone().map(|(along, across)| height(along, across)).max().unwrap_or(0);
        if cells.into_iter().all(|(along, across)| height(along, across) == top) {
            return Self::Whole;
        }
        let (last, end) = (extent.length - 1, extent.breadth - 1);
        let corners = [(0, 0), (0, end), (last, 0), (last, end)];
        match corners.into_iter().filter(|&(along, across)| height(along, across) == top).count() {
            4 => Self::FourCorners,
            3 => Self::ThreeCorners,
            _ => Self::FewerCorners,
        }
    }
}

/// Sets the boxes of one container down, one after the other, and shakes it then.
///
/// # Errors
/// [`PlaceError`] if the plan breaks its own rules.
pub(crate) fn play(
    plan: &[PlacedBox],
    size: ContainerSize,
    rules: Rules,
    imperfections: &Imperfections,
    shake_g: f64,
) -> Result<PlayedContainer, PlaceError> {
    let mut grid = Grid::with_rules(size, 1, rules).expect("one container of a grid is a grid");
    let mut container = RigidContainer::new(size);
    let (mut boxes, mut let_go) = (Vec::with_capacity(plan.len()), Vec::<Lying>::with_capacity(plan.len()));
    let mut restless = 0;
    for placed in plan {
        let placement = packing::Placement { slot: 0, ..placed.placement };
        let room = grid.extent(&placed.spec).turned(placement.yaw);
        let footing = Footing::of(grid.slots()[0].surface().heights(), size, room, [placement.i, placement.j]);
        grid.place(&placed.spec, placement)?;
        let Some(brought) = imperfections.bring(&placed.spec, room, placement, size) else { continue };
        let settled = container.set_down(&brought);
        restless += usize::from(!settled.is_at_rest);
        boxes.push(PlayedBox { footing, collided: settled.collided, fate: Fate::default() });
        let_go.push(settled.let_go);
        for (played, let_go) in boxes.iter_mut().zip(&let_go) {
            let lies = container.lying().iter().find(|lying| lying.box_id == let_go.box_id);
            played.fate = played.fate.and(Fate::of(let_go, lies));
        }
    }
    let shifted = container.shifted_by_shaking(shake_g);
    Ok(PlayedContainer { boxes, lying: container.lying().to_vec(), shifted, restless })
}

#[cfg(test)]
mod tests {
    use packing::{BoxSpec, Placement, Support, Yaw};

    use super::*;

    #[test]
    fn a_footing_is_told_by_its_corners() {
        let size = ContainerSize::new(4, 4, 9, 10).unwrap();
        let extent = Extent { length: 3, breadth: 3, height: 1 };
        let of = |heights: [u16; 16]| Footing::of(&heights, size, extent, [0, 1]);
        assert_eq!(of([0; 16]), Footing::Whole);
        assert_eq!(of([9, 2, 2, 2, 9, 2, 1, 2, 9, 2, 2, 2, 9, 9, 9, 9]), Footing::FourCorners);
        assert_eq!(of([9, 2, 2, 2, 9, 2, 2, 2, 9, 2, 2, 1, 9, 9, 9, 9]), Footing::ThreeCorners);
        assert_eq!(of([9, 2, 2, 0, 9, 2, 2, 0, 9, 2, 2, 0, 9, 9, 9, 9]), Footing::FewerCorners);
    }

    /// A plank on two posts of different heights is level by a plan that rounds heights up, and lies askew in truth.
    #[test]
    fn a_container_is_played_as_planned() {
        let size = ContainerSize::new(30, 30, 30, 10).unwrap();
        let rules = Rules { support: Support::Partial, ..Rules::default() };
        let place = |id: u64, sides_mm: [u32; 3], i: u16, base: u16| PlacedBox {
            spec: BoxSpec::new(id, sides_mm).unwrap(),
            placement: Placement { slot: 3, yaw: Yaw::Deg0, i, j: 0, base },
            container: 3,
        };
        let plan = [
            place(1, [100, 100, 100], 0, 0),
            place(2, [100, 100, 91], 20, 0),
            place(3, [300, 100, 50], 0, 10),
            place(4, [100, 100, 100], 20, 15),
        ];
        let played = play(&plan, size, rules, &Imperfections::default(), 0.3).unwrap();
        let footings: Vec<_> = played.boxes.iter().map(|played| played.footing).collect();
        assert_eq!(footings, [Footing::Whole, Footing::Whole, Footing::FourCorners, Footing::Whole]);
        assert_eq!((played.lying.len(), played.restless), (4, 0));
        assert!(played.boxes.iter().all(|played| !played.collided && !played.fate.fell), "{:?}", played.boxes);
        let misfit = [place(1, [100, 100, 100], 0, 3)];
        assert!(play(&misfit, size, rules, &Imperfections::default(), 0.3).is_err());
    }
}
