//! The best first move by a plan for the current box and those known to follow.
//!
//! A plan places the boxes one after another. Its measure is the sum of its moves' values by the network, minus
//! [`OPENING_COST`] for every container it opens and [`MISFIT_COST`] for every box that fits nowhere. Plans are
//! searched by beams of growing width; the first is greedy. The best plan so far is kept, so that the search can be
//! stopped at any time and more time never gives a plan that measures less.
//!
//! A [`Planner`] keeps its memory from box to box: everything that a search makes lies in lists that are emptied and
//! filled again, and refers to other things by their number in them.

use std::ops::Range;

use packing::{Candidate, ContainerSize, Extent, Grid, Place, Placement, Rules, Surface, corner_places};

use crate::moves::{ContainerView, Features, features};

/// Boxes beyond the current one that are planned for; more that are known are left out.
pub const UPCOMING_MAX: usize = 8;

/// Nodes kept after the current box, beam by beam; half as many after every later box.
pub(crate) const WIDTHS: [usize; 3] = [1, 4, 12];

/// What opening a container takes off a plan's measure.
pub(crate) const OPENING_COST: f32 = 20.0;

/// What a box that fits nowhere takes off a plan's measure.
const MISFIT_COST: f32 = 100.0;

/// The number of the fresh container among those of a search.
const FRESH: usize = 0;

/// Surfaces that have room from the start: those that the beams of [`WIDTHS`] make for [`UPCOMING_MAX`] boxes, and the
/// fresh one.
const SURFACES_RESERVED: usize = 1 + 12 + (1 + 2 + 6) * (UPCOMING_MAX - 1);

/// Moves that have room from the start.
const MOVES_RESERVED: usize = 1 << 15;

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

/// One container at some time in a plan.
#[derive(Clone, Debug)]
struct Container {
    surface: Source,
    view: ContainerView,
    /// By box, as soon as they are asked for: where its moves lie.
    moves: [Option<(u32, u32)>; 1 + UPCOMING_MAX],
}

/// Whose surface a container has.
#[derive(Clone, Copy, Debug)]
enum Source {
    /// That of a slot of the grid.
    Slot(u16),
    /// One of the planner's own.
    Own(usize),
}

/// The containers after some boxes of a plan.
#[derive(Clone, Copy, Debug)]
struct Node {
    first: usize,
    measure: f32,
    /// Where the numbers of its open containers lie.
    open_from: usize,
    open_count: usize,
    fresh_left: usize,
}

/// A node and one of its moves, or none for a box that fits nowhere.
#[derive(Clone, Copy, Debug)]
struct Child {
    /// Of equal measures, the smallest number is best.
    number: usize,
    node: usize,
    target: Option<(usize, Move)>,
    measure: f32,
}

/// Gives the values of moves; the error is the caller's own.
pub(crate) trait Value {
    type Error;

    /// Writes the value of every move into `values`, which are cleared first.
    fn values(&mut self, moves: &[Features], values: &mut Vec<f32>) -> Result<(), Self::Error>;
}

/// Plans, and keeps its memory.
#[derive(Debug, Default)]
pub(crate) struct Planner {
    /// Of its beams, rising.
    widths: Vec<usize>,
    /// What the fresh container is one of.
    kind: Option<(ContainerSize, Rules)>,
    /// The fresh container's, and after it those of containers in which boxes were planned.
    surfaces: Vec<Surface>,
    surfaces_used: usize,
    containers: Vec<Container>,
    extents: Vec<Extent>,
    moves: Vec<Move>,
    open: Vec<usize>,
    expanded: Vec<Node>,
    nodes: Vec<Node>,
    next: Vec<Node>,
    firsts: Vec<Child>,
    children: Vec<Child>,
    pending: Vec<(usize, Range<usize>)>,
    batch: Vec<Features>,
    values: Vec<f32>,
    places: Vec<Place>,
}

/// The search of one decision.
struct Search<'a, V> {
    grid: &'a Grid,
    value: &'a mut V,
    memory: &'a mut Planner,
}

impl Planner {
    /// A planner that searches by beams of these widths, which rise.
    pub(crate) fn new(widths: &[usize]) -> Self {
        Self { widths: widths.to_vec(), ..Self::default() }
    }

    /// Plans from the current box's candidates and their values; nothing if there are none.
    ///
    /// The first of the `extents` is the current box's, and at most [`UPCOMING_MAX`] after it are planned for. `values`
    /// belongs to `candidates`. `is_over` is asked before every piece of work.
    pub(crate) fn plan<V: Value>(
        &mut self,
        grid: &Grid,
        extents: impl IntoIterator<Item = Extent>,
        candidates: &[Candidate],
        values: &[f32],
        value: &mut V,
        is_over: &mut dyn FnMut() -> bool,
    ) -> Result<Option<Plan>, V::Error> {
        let greedy = (0..values.len()).reduce(|best, index| if values[index] > values[best] { index } else { best });
        let Some(greedy) = greedy else { return Ok(None) };
        let best = Plan { first: greedy, measure: values[greedy], depth: 1, width: 0 };
        self.begin(grid, extents);
        if self.extents.len() < 2 || is_over() {
            return Ok(Some(best));
        }
        let mut search = Search { grid, value, memory: self };
        let root = search.root();
        search.find_firsts(root, candidates, values);
        search.widen(root, best, is_over).map(Some)
    }

    /// Forgets the last search, and makes room for one of this grid.
    fn begin(&mut self, grid: &Grid, extents: impl IntoIterator<Item = Extent>) {
        let kind = (grid.size(), grid.rules());
        if self.kind != Some(kind) {
            self.kind = Some(kind);
            self.surfaces.clear();
            self.surfaces.resize(SURFACES_RESERVED, Surface::with_rules(grid.size(), grid.rules()));
            self.moves.reserve(MOVES_RESERVED);
        }
        self.surfaces_used = 1 + FRESH;
        self.containers.clear();
        self.moves.clear();
        self.open.clear();
        self.expanded.clear();
        self.extents.clear();
        self.extents.extend(extents.into_iter().take(1 + UPCOMING_MAX));
    }

    fn surface<'a>(&'a self, grid: &'a Grid, container: usize) -> &'a Surface {
        match self.containers[container].surface {
            Source::Slot(slot) => grid.slots()[usize::from(slot)].surface(),
            Source::Own(number) => &self.surfaces[number],
        }
    }

    fn add(&mut self, surface: Source, view: ContainerView) -> usize {
        self.containers.push(Container { surface, view, moves: [None; 1 + UPCOMING_MAX] });
        self.containers.len() - 1
    }

    fn open_of(&self, node: &Node) -> &[usize] {
        &self.open[node.open_from..node.open_from + node.open_count]
    }

    /// A container with a box of `turned` extent set down in it as planned; the container itself stays as it is.
    fn set_down(&mut self, grid: &Grid, container: usize, turned: Extent, placement: Placement) -> Option<usize> {
        let number = self.surfaces_used;
        if number == self.surfaces.len() {
            self.surfaces.push(self.surfaces[FRESH].clone());
        }
        let (made, free) = self.surfaces.split_at_mut(number);
        let Container { surface, view, .. } = self.containers[container];
        free[0].clone_from(match surface {
            Source::Slot(slot) => grid.slots()[usize::from(slot)].surface(),
            Source::Own(own) => &made[own],
        });
        let base = free[0].place(turned, placement.i, placement.j).ok()?;
        self.surfaces_used += 1;
        let view = ContainerView {
            packed_cells: view.packed_cells + turned.volume_cells() as u32,
            highest: view.highest.max(base + turned.height),
            ..view
        };
        Some(self.add(Source::Own(number), view))
    }
}

impl<V: Value> Search<'_, V> {
    /// The containers as they stand, and the fresh one.
    fn root(&mut self) -> Node {
        let (grid, memory) = (self.grid, &mut *self.memory);
        let open_count = grid.open_slots().count();
        let open = open_count as u16;
        let _is_fresh = memory.add(Source::Own(FRESH), ContainerView { rank: open, open, packed_cells: 0, highest: 0 });
        for (rank, slot) in (0..).zip(grid.open_slots()) {
            let view = ContainerView::of(grid.slots()[usize::from(slot)].surface(), rank, open);
            let number = memory.add(Source::Slot(slot), view);
            memory.open.push(number);
        }
        Node { first: 0, measure: 0.0, open_from: 0, open_count, fresh_left: grid.slots().len() - open_count }
    }

    /// The current box's moves are the candidates; the plan may not know better which there are. The best are kept.
    fn find_firsts(&mut self, root: Node, candidates: &[Candidate], values: &[f32]) {
        let Planner { firsts, containers, open, widths, .. } = &mut *self.memory;
        let is_in =
            |container: usize, slot: u16| matches!(containers[container].surface, Source::Slot(own) if own == slot);
        firsts.clear();
        for (number, (candidate, &value)) in candidates.iter().zip(values).enumerate() {
            let placement = candidate.placement;
            let known = open.iter().position(|&container| is_in(container, placement.slot));
            let cost = if known.is_none() { OPENING_COST } else { 0.0 };
            let target = Some((known.unwrap_or(root.open_count), Move { placement, value }));
            firsts.push(Child { number, node: 0, target, measure: value - cost });
        }
        keep_best(firsts, widths.last().copied().unwrap_or(1));
    }

    /// One beam after another, until time is over or a wider one cannot find more.
    fn widen(&mut self, root: Node, mut best: Plan, is_over: &mut dyn FnMut() -> bool) -> Result<Plan, V::Error> {
        let (boxes, firsts) = (self.memory.extents.len(), self.memory.firsts.len());
        for beam in 0..self.memory.widths.len() {
            let width = self.memory.widths[beam];
            // The first moves of a narrower beam are those of a wider one, so their nodes are kept.
            while self.memory.expanded.len() < width.min(firsts) {
                if is_over() {
                    return Ok(best);
                }
                let child = self.memory.firsts[self.memory.expanded.len()];
                let node = Node { first: child.number, ..self.step(root, child, 0) };
                self.memory.expanded.push(node);
            }
            let Planner { nodes, expanded, .. } = &mut *self.memory;
            nodes.clear();
            nodes.extend(expanded.iter().take(width));
            let Some(found) = self.beam(width, is_over)? else { return Ok(best) };
            let is_better = best.width == 0 || found.1 > best.measure;
            let (first, measure) = if is_better { found } else { (best.first, best.measure) };
            best = Plan { first, measure, depth: boxes as u8, width: width as u16 };
            if firsts < width / 2 {
                break;
            }
        }
        Ok(best)
    }

    /// The first move and the measure of the best plan that goes on from the nodes; nothing if time ran out.
    fn beam(&mut self, width: usize, is_over: &mut dyn FnMut() -> bool) -> Result<Option<(usize, f32)>, V::Error> {
        let last = self.memory.extents.len() - 1;
        for depth in 1..=last {
            if !self.value_moves(depth, is_over)? {
                return Ok(None);
            }
            self.find_children(depth);
            let Planner { nodes, children, next, .. } = &mut *self.memory;
            if depth == last {
                let better = |best: Child, child: Child| if is_better(&child, &best) { child } else { best };
                let best = children.iter().copied().reduce(better);
                return Ok(best.map(|child| (nodes[child.node].first, child.measure)));
            }
            keep_best(children, (width / 2).max(1));
            next.clear();
            for number in 0..children.len() {
                if is_over() {
                    return Ok(None);
                }
                let child = self.memory.children[number];
                let after = self.step(self.memory.nodes[child.node], child, depth);
                self.memory.next.push(after);
            }
            std::mem::swap(&mut self.memory.nodes, &mut self.memory.next);
        }
        Ok(None)
    }

    /// Values the moves of box `depth` in all containers of the nodes where they are not known; false if time ran out.
    fn value_moves(&mut self, depth: usize, is_over: &mut dyn FnMut() -> bool) -> Result<bool, V::Error> {
        let extent = self.memory.extents[depth];
        let known = self.memory.moves.len();
        self.memory.batch.clear();
        self.memory.pending.clear();
        for node in 0..=self.memory.nodes.len() {
            let count = self.memory.nodes.get(node).map_or(1, |node| node.open_count);
            for place in 0..count {
                let container = self.memory.nodes.get(node).map_or(FRESH, |node| self.memory.open_of(node)[place]);
                let is_known = self.memory.containers[container].moves[depth].is_some();
                if is_known || self.memory.pending.iter().any(|(other, _)| *other == container) {
                    continue;
                }
                if is_over() {
                    self.memory.moves.truncate(known);
                    return Ok(false);
                }
                self.describe_moves(container, extent);
            }
        }
        let Planner { batch, values, moves, pending, containers, .. } = &mut *self.memory;
        if let Err(error) = self.value.values(batch, values) {
            moves.truncate(known);
            return Err(error);
        }
        moves[known..].iter_mut().zip(&*values).for_each(|(a_move, &value)| a_move.value = value);
        for (container, range) in pending {
            containers[*container].moves[depth] = Some((range.start as u32, range.end as u32));
        }
        Ok(true)
    }

    /// Appends the moves of a box of `extent` into a container, and their features.
    fn describe_moves(&mut self, container: usize, extent: Extent) {
        let (mut moves, mut batch, mut places) = (
            std::mem::take(&mut self.memory.moves),
            std::mem::take(&mut self.memory.batch),
            std::mem::take(&mut self.memory.places),
        );
        let (surface, view) = (self.memory.surface(self.grid, container), &self.memory.containers[container].view);
        let from = moves.len();
        corner_places(surface, 0, extent, &mut places, |placement| {
            batch.push(features(surface, view, extent.turned(placement.yaw), placement));
            moves.push(Move { placement, value: 0.0 });
        });
        self.memory.pending.push((container, from..moves.len()));
        (self.memory.moves, self.memory.batch, self.memory.places) = (moves, batch, places);
    }

    /// What box `depth` can do in every node: a fresh container only if no open one has a place.
    fn find_children(&mut self, depth: usize) {
        let Planner { nodes, children, containers, moves, open, .. } = &mut *self.memory;
        children.clear();
        let moves_into = |container: usize| {
            let (from, to) = containers[container].moves[depth].unwrap_or_default();
            &moves[from as usize..to as usize]
        };
        let mut push = |node: usize, target: Option<(usize, Move)>, measure: f32| {
            children.push(Child { number: children.len(), node, target, measure });
        };
        for (index, node) in nodes.iter().enumerate() {
            let mut is_stuck = true;
            for (place, &container) in open[node.open_from..node.open_from + node.open_count].iter().enumerate() {
                for &a_move in moves_into(container) {
                    push(index, Some((place, a_move)), node.measure + a_move.value);
                    is_stuck = false;
                }
            }
            if is_stuck && node.fresh_left > 0 {
                for &a_move in moves_into(FRESH) {
                    let measure = node.measure + a_move.value - OPENING_COST;
                    push(index, Some((node.open_count, a_move)), measure);
                    is_stuck = false;
                }
            }
            if is_stuck {
                push(index, None, node.measure - MISFIT_COST);
            }
        }
    }

    /// The node after a child's move of box `depth`.
    fn step(&mut self, node: Node, child: Child, depth: usize) -> Node {
        let memory = &mut *self.memory;
        let open_from = memory.open.len();
        memory.open.extend_from_within(node.open_from..node.open_from + node.open_count);
        let mut next = Node { measure: child.measure, open_from, ..node };
        if let Some((place, a_move)) = child.target {
            let turned = memory.extents[depth].turned(a_move.placement.yaw);
            let is_open = place < node.open_count;
            let container = if is_open { memory.open[open_from + place] } else { FRESH };
            match memory.set_down(self.grid, container, turned, a_move.placement) {
                Some(placed) if is_open => memory.open[open_from + place] = placed,
                Some(placed) => {
                    memory.open.push(placed);
                    next.open_count += 1;
                    next.fresh_left = next.fresh_left.saturating_sub(1);
                }
                None => next.measure = f32::NEG_INFINITY,
            }
        }
        next
    }
}

/// Whether a child comes before another: a higher measure, or an equal one earlier.
fn is_better(child: &Child, other: &Child) -> bool {
    order(child, other).is_lt()
}

fn order(a: &Child, b: &Child) -> std::cmp::Ordering {
    b.measure.total_cmp(&a.measure).then(a.number.cmp(&b.number))
}

/// Keeps the best children, at least one if there is any, best first.
fn keep_best(children: &mut Vec<Child>, count: usize) {
    let count = count.max(1);
    if children.len() > count {
        children.select_nth_unstable_by(count - 1, order);
        children.truncate(count);
    }
    children.sort_unstable_by(order);
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

        fn values(&mut self, moves: &[Features], values: &mut Vec<f32>) -> Result<(), Infallible> {
            values.clear();
            values.extend(moves.iter().map(|features| self.0.value_of_move(features)));
            Ok(())
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
        let (mut candidates, mut moves, mut values, mut asked) = (Vec::new(), Vec::new(), Vec::new(), 0);
        corner_candidates(grid, extents[0], &WalleWeights::PAPER, &mut candidates);
        describe(grid, extents[0], &candidates, &mut moves);
        let Ok(()) = plain.values(&moves, &mut values);
        let mut planner = Planner::new(widths);
        let mut is_over = || {
            asked += 1;
            asked > limit
        };
        let extents = extents.iter().copied();
        // The second search finds the memory of the first, which was stopped somewhere.
        let Ok(_) = planner.plan(grid, extents.clone(), &candidates, &values, &mut plain, &mut is_over);
        asked = 0;
        let mut is_over = || {
            asked += 1;
            asked > limit
        };
        let Ok(plan) = planner.plan(grid, extents, &candidates, &values, &mut plain, &mut is_over);
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
