//! The best first move by a plan for the current box and those known to follow.
//!
//! A plan places the boxes one after another. Its measure is the sum of its moves' values by the network, minus
//! [`OPENING_COST`] for every container it opens and [`MISFIT_COST`] for every box that fits nowhere. Plans are
//! searched by beams of growing width; the first is greedy. The best plan so far is kept, so that the search can be
//! stopped at any time and more time never gives a plan that measures less.

use std::borrow::Cow;
use std::cell::RefCell;
use std::rc::Rc;

use packing::{Candidate, Extent, Grid, Placement, Surface, corner_places};

use crate::moves::{ContainerView, Features, features};

/// Boxes beyond the current one that are planned for; more that are known are left out.
pub const UPCOMING_MAX: usize = 8;

/// Nodes kept after the current box, beam by beam; half as many after every later box.
pub(crate) const WIDTHS: [usize; 3] = [1, 4, 12];

/// What opening a container takes off a plan's measure.
pub(crate) const OPENING_COST: f32 = 20.0;

/// What a box that fits nowhere takes off a plan's measure.
const MISFIT_COST: f32 = 100.0;

/// The best plan found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plan {
    /// Index of the current box's candidate.
    pub(crate) first: usize,
    /// Its measure; the candidate's own value while no plan was finished.
    pub(crate) measure: f32,
    /// Boxes planned for, at least 1.
    pub(crate) depth: u8,
    /// Width of the widest beam that was finished; 0 while none was.
    pub(crate) width: u16,
}

/// A way to place one box in one container.
#[derive(Clone, Copy, Debug)]
struct Move {
    placement: Placement,
    value: f32,
}

/// One container at some time in a plan, and the moves into it that were valued.
#[derive(Debug)]
struct Container<'a> {
    surface: Cow<'a, Surface>,
    view: ContainerView,
    /// By box, as soon as they are asked for.
    moves: RefCell<Vec<Option<Vec<Move>>>>,
}

/// The containers after some boxes of a plan.
#[derive(Clone, Debug)]
struct Node<'a> {
    first: usize,
    measure: f32,
    open: Vec<Rc<Container<'a>>>,
    fresh_left: usize,
}

/// A node and one of its moves, or none for a box that fits nowhere.
struct Child {
    node: usize,
    target: Option<(usize, Move)>,
    measure: f32,
}

/// Gives the values of moves; the error is the caller's own.
pub(crate) trait Value {
    type Error;
    fn values(&mut self, moves: &[Features]) -> Result<Vec<f32>, Self::Error>;
}

/// The search of one decision.
struct Search<'a, 'b, V> {
    extents: Vec<Extent>,
    fresh: Rc<Container<'a>>,
    value: &'b mut V,
    batch: Vec<Features>,
}

impl<'a> Container<'a> {
    fn new(surface: Cow<'a, Surface>, view: ContainerView, boxes: usize) -> Rc<Self> {
        Rc::new(Self { surface, view, moves: RefCell::new(vec![None; boxes]) })
    }

    /// The container with a box of `turned` extent set down as planned.
    fn with(&self, turned: Extent, placement: Placement, boxes: usize) -> Option<Rc<Container<'a>>> {
        let mut surface = self.surface.clone().into_owned();
        let base = surface.place(turned, placement.i, placement.j).ok()?;
        let view = ContainerView {
            packed_cells: self.view.packed_cells + turned.volume_cells() as u32,
            highest: self.view.highest.max(base + turned.height),
            ..self.view
        };
        Some(Container::new(Cow::Owned(surface), view, boxes))
    }
}

/// Plans from the current box's candidates and their values.
///
/// `values` belongs to `candidates`; `widths` rise. `is_over` is asked before every piece of work.
pub(crate) fn plan<V: Value>(
    grid: &Grid,
    extents: Vec<Extent>,
    candidates: &[Candidate],
    values: &[f32],
    value: &mut V,
    widths: &[usize],
    is_over: &mut dyn FnMut() -> bool,
) -> Result<Option<Plan>, V::Error> {
    let greedy = (0..values.len()).reduce(|best, index| if values[index] > values[best] { index } else { best });
    let Some(greedy) = greedy else { return Ok(None) };
    let mut best = Plan { first: greedy, measure: values[greedy], depth: 1, width: 0 };
    if extents.len() < 2 || is_over() {
        return Ok(Some(best));
    }
    let boxes = extents.len();
    let open: Vec<u16> = grid.open_slots().collect();
    let count = open.len() as u16;
    let root = Node {
        first: 0,
        measure: 0.0,
        open: (0..)
            .zip(&open)
            .map(|(rank, &slot)| {
                let surface = grid.slots()[usize::from(slot)].surface();
                Container::new(Cow::Borrowed(surface), ContainerView::of(surface, rank, count), boxes)
            })
            .collect(),
        fresh_left: grid.slots().len() - open.len(),
    };
    let view = ContainerView { rank: count, open: count, packed_cells: 0, highest: 0 };
    let fresh = Container::new(Cow::Owned(Surface::empty(grid.size())), view, boxes);
    let mut search = Search { extents, fresh, value, batch: Vec::new() };

    // The current box's moves are the candidates; the plan may not know better which there are.
    let mut children: Vec<Child> = Vec::new();
    let mut firsts: Vec<usize> = Vec::new();
    for (index, (candidate, &value)) in candidates.iter().zip(values).enumerate() {
        let place = candidate.placement;
        let container = open.iter().position(|&slot| slot == place.slot).unwrap_or(open.len());
        let cost = if container == open.len() { OPENING_COST } else { 0.0 };
        let target = Some((container, Move { placement: place, value }));
        children.push(Child { node: 0, target, measure: value - cost });
        firsts.push(index);
    }
    let mut order: Vec<usize> = (0..children.len()).collect();
    order.sort_by(|&a, &b| children[b].measure.total_cmp(&children[a].measure).then(a.cmp(&b)));
    let mut expanded: Vec<Node<'_>> = Vec::new();
    for &width in widths {
        // The first moves of a narrower beam are those of a wider one, so their nodes are kept.
        while expanded.len() < width.min(order.len()) {
            if is_over() {
                return Ok(Some(best));
            }
            let index = order[expanded.len()];
            let mut node = search.step(&root, &children[index], 0);
            node.first = firsts[index];
            expanded.push(node);
        }
        let nodes = expanded[..width.min(expanded.len())].to_vec();
        let Some(found) = search.beam(nodes, width, is_over)? else { return Ok(Some(best)) };
        let is_better = best.width == 0 || found.1 > best.measure;
        let (first, measure) = if is_better { found } else { (best.first, best.measure) };
        best = Plan { first, measure, depth: boxes as u8, width: width as u16 };
        if order.len() <= width && width / 2 > order.len() {
            break;
        }
    }
    Ok(Some(best))
}

impl<'a, V: Value> Search<'a, '_, V> {
    /// The first move and the measure of the best plan that goes on from `nodes`; nothing if time ran out.
    fn beam(
        &mut self,
        mut nodes: Vec<Node<'a>>,
        width: usize,
        is_over: &mut dyn FnMut() -> bool,
    ) -> Result<Option<(usize, f32)>, V::Error> {
        let last = self.extents.len() - 1;
        let width = (width / 2).max(1);
        for depth in 1..=last {
            if !self.value_moves(&nodes, depth, is_over)? {
                return Ok(None);
            }
            let mut children: Vec<Child> = Vec::new();
            for (index, node) in nodes.iter().enumerate() {
                self.push_children(index, node, depth, &mut children);
            }
            // Earlier nodes, containers and places win ties, because the sort is stable.
            children.sort_by(|a, b| b.measure.total_cmp(&a.measure));
            if depth == last {
                return Ok(children.first().map(|child| (nodes[child.node].first, child.measure)));
            }
            children.truncate(width);
            let mut next = Vec::with_capacity(children.len());
            for child in &children {
                if is_over() {
                    return Ok(None);
                }
                next.push(self.step(&nodes[child.node], child, depth));
            }
            nodes = next;
        }
        Ok(None)
    }

    /// Values the moves of box `depth` in all containers of the nodes where they are not known; false if time ran out.
    fn value_moves(
        &mut self,
        nodes: &[Node<'a>],
        depth: usize,
        is_over: &mut dyn FnMut() -> bool,
    ) -> Result<bool, V::Error> {
        let extent = self.extents[depth];
        self.batch.clear();
        let mut pending: Vec<(Rc<Container<'a>>, Vec<Move>)> = Vec::new();
        for container in nodes.iter().flat_map(|node| &node.open).chain([&self.fresh]) {
            let is_known = container.moves.borrow()[depth].is_some();
            if is_known || pending.iter().any(|(other, _)| Rc::ptr_eq(other, container)) {
                continue;
            }
            if is_over() {
                return Ok(false);
            }
            let mut moves = Vec::new();
            corner_places(&container.surface, 0, extent, |placement| {
                let turned = extent.turned(placement.yaw);
                self.batch.push(features(&container.surface, &container.view, turned, placement));
                moves.push(Move { placement, value: 0.0 });
            });
            pending.push((container.clone(), moves));
        }
        let mut values = self.value.values(&self.batch)?.into_iter();
        for (container, mut moves) in pending {
            moves.iter_mut().zip(&mut values).for_each(|(a_move, value)| a_move.value = value);
            container.moves.borrow_mut()[depth] = Some(moves);
        }
        Ok(true)
    }

    /// Appends what box `depth` can do in a node: a fresh container only if no open one has a place.
    fn push_children(&self, index: usize, node: &Node<'a>, depth: usize, children: &mut Vec<Child>) {
        let before = children.len();
        for (container, state) in node.open.iter().enumerate() {
            for &a_move in state.moves.borrow()[depth].iter().flatten() {
                let measure = node.measure + a_move.value;
                children.push(Child { node: index, target: Some((container, a_move)), measure });
            }
        }
        if children.len() == before && node.fresh_left > 0 {
            for &a_move in self.fresh.moves.borrow()[depth].iter().flatten() {
                let measure = node.measure + a_move.value - OPENING_COST;
                children.push(Child { node: index, target: Some((node.open.len(), a_move)), measure });
            }
        }
        if children.len() == before {
            children.push(Child { node: index, target: None, measure: node.measure - MISFIT_COST });
        }
    }

    /// The node after a child's move of box `depth`.
    fn step(&self, node: &Node<'a>, child: &Child, depth: usize) -> Node<'a> {
        let mut next = Node { measure: child.measure, ..node.clone() };
        if let Some((container, a_move)) = child.target {
            let turned = self.extents[depth].turned(a_move.placement.yaw);
            let state = node.open.get(container).unwrap_or(&self.fresh);
            match (state.with(turned, a_move.placement, self.extents.len()), next.open.get_mut(container)) {
                (Some(placed), Some(place)) => *place = placed,
                (Some(placed), None) => {
                    next.open.push(placed);
                    next.fresh_left = next.fresh_left.saturating_sub(1);
                }
                (None, _) => next.measure = f32::NEG_INFINITY,
            }
        }
        next
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use packing::{BoxSpec, ContainerSize, Draw, WalleWeights, Yaw, corner_candidates};

    use super::*;
    use crate::policy::describe;
    use crate::{Architecture, Weights};

    struct Plain(Weights);

    impl Value for Plain {
        type Error = Infallible;

        fn values(&mut self, moves: &[Features]) -> Result<Vec<f32>, Infallible> {
            Ok(moves.iter().map(|features| self.0.value_of_move(features)).collect())
        }
    }

    fn cells(length: u16, breadth: u16, height: u16) -> Extent {
        Extent { length, breadth, height }
    }

    /// Random boxes in a few containers, and what is known of the belt.
    fn case(number: u64, slots: usize, upcoming: usize) -> (Grid, Vec<Extent>) {
        let mut draw = Draw::new(0, number, 0);
        let mut grid = Grid::new(ContainerSize::new(9, 16, 10, 50).unwrap(), slots).unwrap();
        let mut side = |most: u64| 1 + draw.below(most) as u16;
        for id in 0..25 {
            let spec = BoxSpec::new(id, [side(5), side(8), side(5)].map(|side| u32::from(side) * 50)).unwrap();
            let mut candidates = Vec::new();
            corner_candidates(&grid, spec.extent(50), &WalleWeights::PAPER, &mut candidates);
            if let Some(candidate) = candidates.get(candidates.len() / 2) {
                grid.place(&spec, candidate.placement).unwrap();
            }
        }
        (grid, (0..=upcoming).map(|_| cells(side(5), side(8), side(5))).collect())
    }

    fn search(grid: &Grid, extents: &[Extent], widths: &[usize], limit: usize) -> Option<Plan> {
        let mut plain = Plain(Weights::untrained(Architecture::Moves, &mut Draw::new(0, 1, 0)));
        let (mut candidates, mut moves, mut asked) = (Vec::new(), Vec::new(), 0);
        corner_candidates(grid, extents[0], &WalleWeights::PAPER, &mut candidates);
        describe(grid, extents[0], &candidates, &mut moves);
        let Ok(values) = plain.values(&moves);
        let mut is_over = || {
            asked += 1;
            asked > limit
        };
        let Ok(plan) = plan(grid, extents.to_vec(), &candidates, &values, &mut plain, widths, &mut is_over);
        plan
    }

    /// The measure of the best of all plans, by trying every one of them.
    fn exhaustive(grid: &Grid, extents: &[Extent], weights: &Weights) -> f32 {
        let Some((&extent, later)) = extents.split_first() else { return 0.0 };
        let (mut candidates, mut moves) = (Vec::new(), Vec::new());
        corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
        describe(grid, extent, &candidates, &mut moves);
        let mut best = f32::NEG_INFINITY;
        for (candidate, features) in candidates.iter().zip(&moves) {
            let mut after = grid.clone();
            let is_fresh = !grid.slots()[usize::from(candidate.placement.slot)].is_open();
            let size_mm = [extent.length, extent.breadth, extent.height].map(|side| u32::from(side) * 50);
            after.place(&BoxSpec::new(9, size_mm).unwrap(), candidate.placement).unwrap();
            let cost = if is_fresh { OPENING_COST } else { 0.0 };
            best = best.max(weights.value_of_move(features) - cost + exhaustive(&after, later, weights));
        }
        if candidates.is_empty() { exhaustive(grid, later, weights) - MISFIT_COST } else { best }
    }

    #[test]
    fn a_beam_that_is_wide_enough_finds_the_best_of_all_plans() {
        let weights = Weights::untrained(Architecture::Moves, &mut Draw::new(0, 1, 0));
        let mut compared = 0;
        for number in 0..12 {
            let (grid, extents) = case(number, 2, 1);
            let Some(plan) = search(&grid, &extents, &[1, 10_000], usize::MAX) else { continue };
            let best = exhaustive(&grid, &extents, &weights);
            // Containers opened within a plan do not change how the others are seen, which the definition does.
            if grid.fresh_slot().is_none() {
                assert!((plan.measure - best).abs() < 1e-4, "case {number}: {} and not {best}", plan.measure);
                compared += 1;
            }
        }
        assert!(compared > 3);
    }

    #[test]
    fn more_time_never_gives_a_worse_plan() {
        for number in 0..8 {
            for upcoming in [1, 2, 4, UPCOMING_MAX] {
                let (grid, extents) = case(number, 4, upcoming);
                let plans = (0..400).step_by(7).filter_map(|limit| search(&grid, &extents, &WIDTHS, limit));
                let plans: Vec<Plan> = plans.chain(search(&grid, &extents, &WIDTHS, usize::MAX)).collect();
                for pair in plans.windows(2) {
                    assert!(pair[1].depth >= pair[0].depth && pair[1].width >= pair[0].width);
                    let comparable = pair[0].depth > 1;
                    assert!(!comparable || pair[1].measure >= pair[0].measure, "case {number}: {pair:?}");
                }
                if let (Some(first), Some(last)) = (plans.first(), plans.last()) {
                    assert_eq!((first.depth, first.width), (1, 0), "no time is enough for a choice");
                    assert_eq!(usize::from(last.depth), extents.len());
                }
            }
        }
    }

    #[test]
    fn without_upcoming_boxes_or_candidates_there_is_nothing_to_plan() {
        let (grid, extents) = case(1, 4, 0);
        let plan = search(&grid, &extents, &WIDTHS, usize::MAX).unwrap();
        assert_eq!((plan.depth, plan.width), (1, 0));
        assert_eq!(search(&grid, &[cells(1, 1, 11), cells(1, 1, 1)], &WIDTHS, usize::MAX), None);
    }

    /// The only free level of 9 x 16 takes either the current box and the next, or the current box in its middle.
    #[test]
    fn a_plan_keeps_room_for_the_next_box() {
        let mut grid = Grid::new(ContainerSize::new(9, 16, 10, 50).unwrap(), 1).unwrap();
        let place = Placement { slot: 0, yaw: Yaw::Deg0, i: 0, j: 0, base: 0 };
        grid.place(&BoxSpec::new(0, [450, 300, 500]).unwrap(), place).unwrap();
        let extents = [cells(9, 4, 10), cells(9, 6, 10)];
        let plan = search(&grid, &extents, &WIDTHS, usize::MAX).unwrap();
        assert!(plan.measure > -MISFIT_COST / 2.0, "both boxes have a place: {plan:?}");
    }
}
