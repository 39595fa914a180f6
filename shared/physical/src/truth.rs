//! Where boxes really stand.

use packing::{BOX_SIDE_MM_MAX, BoxSpec, ContainerSize, Extent, Placement, Yaw};
use serde::{Deserialize, Serialize};

use crate::errors::{Of, draw, happens, normal};
use crate::{Lying, RigidContainer};

/// Bodies that come nearer than this touch without colliding [mm]: it is rounding.
const TOUCH_MM: f64 = 1e-6;

/// A box set down on something that is at most so much higher than meant has landed softly, not collided [mm]. The
/// heights of a belief are rounded up, so it is mostly lower.
pub(crate) const SOFT_MM: f64 = 5.0;

/// How wrong the world is. The default is not at all.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Imperfections {
    /// Fixes all errors.
    pub seed: u64,
    /// Standard deviation of the arm's error along each axis [mm]; no error exceeds three of them.
    pub actuator_mm: f64,
    /// Standard deviation of the arm's error of yaw [degrees]; no error exceeds three of them.
    pub yaw_deg: f64,
    /// Standard deviation of the error with which each side of a box is measured at the pick [mm]; at most three.
    pub size_mm: f64,
    /// Probability that the arm refuses a command [-].
    pub refuse_share: f64,
    /// Probability that a box is lost on its way and the arm does not notice [-].
    pub drop_share: f64,
    /// How far a box gives way to one that is set down into it, if nothing stands on it or behind it [mm].
    pub push_mm: f64,
}

/// A box that stands in a container.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Standing {
    /// The box's identity.
    pub box_id: u64,
    /// The middle of its base [mm].
    pub middle_mm: [f64; 2],
    /// Half its sides along `x` and `y` before the error of yaw [mm].
    pub half_mm: [f64; 2],
    /// The error of yaw, anticlockwise from above [rad]; at most an eighth of a turn.
    pub turn_rad: f64,
    /// Height of its base [mm].
    pub base_mm: f64,
    /// Height of its top [mm].
    pub top_mm: f64,
}

/// How it went when a box was set down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landing {
    /// It never arrived, or fell over a wall.
    pub lost: bool,
    /// It touched another box on its way down, or something stood where it was to stand.
    pub collided: bool,
    /// A wall guided it.
    pub walls: bool,
    /// Other boxes that it pushed aside.
    pub pushed: u32,
    /// Boxes still moved after ten seconds, and were left as they were.
    pub restless: bool,
    /// From where it was meant to stand to where it stands, along `x` and `y` [mm].
    pub offset_mm: [f64; 2],
}

/// All boxes in all containers.
#[derive(Clone, Debug)]
pub struct Truth {
    imperfections: Imperfections,
    size: ContainerSize,
    inner_mm: [f64; 2],
    slots: Vec<Vec<Standing>>,
    /// Where boxes can slide, tilt and fall: how they lie. [`Truth::slots`] then is what of it can be seen from above.
    containers: Option<Vec<RigidContainer>>,
}

/// All boxes of a truth, as they outlive a process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Matter {
    /// Boxes that stand where they were set down, slot by slot.
    Standing(Vec<Vec<Standing>>),
    /// Boxes that lie as they fell, slot by slot.
    Lying(Vec<Vec<Lying>>),
}

/// A box that the arm holds over its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brought {
    /// As it is held; nothing is said of its base.
    pub held: Standing,
    /// Its height [mm].
    pub height_mm: f64,
    /// The height of the base that it is meant for [mm].
    pub planned_mm: f64,
    /// Where the middle of its base was meant to be [mm].
    pub meant_mm: [f64; 2],
    /// A wall guided it.
    pub walls: bool,
}

impl Truth {
    /// Empty containers of this size, in which boxes stand where they are set down.
    #[must_use]
    pub fn new(imperfections: Imperfections, size: ContainerSize, slots: usize) -> Self {
        let inner_mm = inner_mm(size);
        Self { imperfections, size, inner_mm, slots: vec![Vec::new(); slots], containers: None }
    }

    /// Empty containers of this size, in which boxes are rigid bodies. They give way as they do, whatever
    /// [`Imperfections::push_mm`] says.
    #[must_use]
    pub fn rigid(imperfections: Imperfections, size: ContainerSize, slots: usize) -> Self {
        let containers = Some(vec![RigidContainer::new(size); slots]);
        Self { containers, ..Self::new(imperfections, size, slots) }
    }

    /// The boxes of every slot as they are seen from above: one that lies askew is a level one around it.
    #[must_use]
    pub fn slots(&self) -> &[Vec<Standing>] {
        &self.slots
    }

    /// All boxes, as [`Truth::go_on`] takes them.
    #[must_use]
    pub fn matter(&self) -> Matter {
        match &self.containers {
            None => Matter::Standing(self.slots.clone()),
            Some(containers) => Matter::Lying(containers.iter().map(|container| container.lying().to_vec()).collect()),
        }
    }

    /// Goes on from boxes that are there; whether they are of such a world with as many slots.
    #[must_use]
    pub fn go_on(&mut self, matter: &Matter) -> bool {
        let slots = self.slots.len();
        match (matter, &mut self.containers) {
            (Matter::Standing(standing), None) if standing.len() == slots => self.slots.clone_from(standing),
            (Matter::Lying(lying), Some(containers)) if lying.len() == slots => {
                for ((container, lying), standing) in containers.iter_mut().zip(lying).zip(&mut self.slots) {
                    container.go_on(lying);
                    *standing = lying.iter().map(Lying::standing).collect();
                }
            }
            _ => return false,
        }
        true
    }

    /// Length and breadth of a container [mm].
    #[must_use]
    pub fn inner_mm(&self) -> [f64; 2] {
        self.inner_mm
    }

    /// The box as it is measured at the pick.
    #[must_use]
    pub fn measured(&self, spec: &BoxSpec) -> BoxSpec {
        let Imperfections { seed, size_mm, .. } = self.imperfections;
        if size_mm == 0.0 {
            return *spec;
        }
        let mut draw = draw(Of::Size, seed, spec.id());
        let mut wrong = |side_mm: u32| {
            let side_mm = (f64::from(side_mm) + size_mm * normal(&mut draw)).round();
            side_mm.clamp(1.0, f64::from(BOX_SIDE_MM_MAX)) as u32
        };
        let sides_mm = spec.size_mm().map(&mut wrong);
        BoxSpec::new(spec.id(), sides_mm).unwrap_or(*spec)
    }

    /// Whether the arm refuses this order.
    #[must_use]
    pub fn refuses(&self, order: u64) -> bool {
        let Imperfections { seed, refuse_share, .. } = self.imperfections;
        refuse_share > 0.0 && happens(&mut draw(Of::Refusal, seed, order), refuse_share)
    }

    /// The arm sets a box of this true size down in the middle of `room` (already turned), as well as it can.
    pub fn set_down(&mut self, spec: &BoxSpec, room: Extent, placement: Placement) -> Landing {
        let mut landing =
            Landing { lost: true, collided: false, walls: false, pushed: 0, restless: false, offset_mm: [0.0; 2] };
        let brought = self.imperfections.bring(spec, room, placement, self.size);
        let (Some(brought), Some(standing)) = (brought, self.slots.get_mut(usize::from(placement.slot))) else {
            return landing;
        };
        landing.walls = brought.walls;
        match &mut self.containers {
            None => {
                landing.lost = false;
                (landing.collided, landing.pushed) = brought.stand(standing, self.imperfections.push_mm, self.inner_mm);
            }
            Some(containers) => {
                let container = &mut containers[usize::from(placement.slot)];
                let settled = container.set_down(&brought);
                landing.lost = !settled.stays;
                (landing.collided, landing.pushed) = (settled.collided, settled.pushed);
                landing.restless = !settled.is_at_rest;
                *standing = container.lying().iter().map(Lying::standing).collect();
            }
        }
        if let Some(landed) = standing.last().filter(|_| !landing.lost) {
            landing.offset_mm = [0, 1].map(|axis| landed.middle_mm[axis] - brought.meant_mm[axis]);
        }
        landing
    }

    /// Something that nobody ordered falls into a container, comes to rest there and moves nothing.
    pub fn intrude(&mut self, slot: u16, middle_mm: [f64; 2], half_mm: [f64; 2], height_mm: f64) {
        if let Some(standing) = self.slots.get_mut(usize::from(slot)) {
            let mut thing = Standing { box_id: 0, middle_mm, half_mm, turn_rad: 0.0, base_mm: 0.0, top_mm: 0.0 };
            let below = standing.iter().filter(|other| thing.overlap(other).is_some());
            thing.base_mm = below.map(|other| other.top_mm).fold(0.0, f64::max);
            thing.top_mm = thing.base_mm + height_mm;
            standing.push(thing);
            if let Some(containers) = &mut self.containers {
                containers[usize::from(slot)].add(Lying::of(&thing));
            }
        }
    }

    /// The container of this slot leaves with what stands in it, and an empty one comes.
    pub fn replace(&mut self, slot: u16) {
        if let Some(standing) = self.slots.get_mut(usize::from(slot)) {
            standing.clear();
        }
        if let Some(container) = self.containers.as_mut().and_then(|all| all.get_mut(usize::from(slot))) {
            container.go_on(&[]);
        }
    }

    /// The height of what stands at a point of a slot, seen from above [mm]; 0 for the floor.
    #[must_use]
    pub fn height_mm(&self, slot: u16, x_mm: f64, y_mm: f64) -> f64 {
        let standing = self.slots.get(usize::from(slot)).map_or(&[][..], Vec::as_slice);
        standing.iter().filter(|one| one.covers(x_mm, y_mm)).map(|one| one.top_mm).fold(0.0, f64::max)
    }
}

/// Length and breadth of a container [mm].
pub(crate) fn inner_mm(size: ContainerSize) -> [f64; 2] {
    [size.length(), size.breadth()].map(|cells| f64::from(cells) * f64::from(size.cell_mm()))
}

impl Imperfections {
    /// The box of this true size, held over the middle of `room` (already turned) as well as the arm can; nothing if it is
    /// lost on its way.
    #[must_use]
    pub fn bring(&self, spec: &BoxSpec, room: Extent, placement: Placement, size: ContainerSize) -> Option<Brought> {
        let Self { seed, actuator_mm, yaw_deg, drop_share, .. } = *self;
        if drop_share > 0.0 && happens(&mut draw(Of::Drop, seed, spec.id()), drop_share) {
            return None;
        }
        let mut draw = draw(Of::Motion, seed, spec.id());
        let cell_mm = f64::from(size.cell_mm());
        let [length_mm, breadth_mm, height_mm] = spec.size_mm().map(f64::from);
        let sides_mm = if placement.yaw == Yaw::Deg0 { [length_mm, breadth_mm] } else { [breadth_mm, length_mm] };
        let middle = |first: u16, cells: u16| (f64::from(first) + f64::from(cells) / 2.0) * cell_mm;
        let meant_mm = [middle(placement.i, room.length), middle(placement.j, room.breadth)];
        let mut held = Standing {
            box_id: spec.id(),
            middle_mm: meant_mm.map(|mm| mm + actuator_mm * normal(&mut draw)),
            half_mm: sides_mm.map(|side| side / 2.0),
            turn_rad: (yaw_deg * normal(&mut draw)).to_radians(),
            base_mm: 0.0,
            top_mm: 0.0,
        };
        let walls = held.stay_inside(inner_mm(size));
        Some(Brought { held, height_mm, planned_mm: f64::from(placement.base) * cell_mm, meant_mm, walls })
    }
}

impl Brought {
    /// It is set down and stands at once on the highest box below it; whether it collided, and how many gave way.
    fn stand(&self, standing: &mut Vec<Standing>, push_mm: f64, inner_mm: [f64; 2]) -> (bool, u32) {
        let (mut landed, mut collided, mut pushed) = (self.held, false, 0);
        for other in 0..standing.len() {
            let is_in_the_way = standing[other].top_mm > self.planned_mm + SOFT_MM;
            if let Some((depth_mm, away)) = landed.overlap(&standing[other]).filter(|_| is_in_the_way) {
                collided = true;
                if depth_mm <= push_mm && push(standing, other, away, depth_mm, inner_mm) {
                    pushed += 1;
                }
            }
        }
        let below = standing.iter().filter(|other| landed.overlap(other).is_some());
        landed.base_mm = below.map(|other| other.top_mm).fold(0.0, f64::max);
        landed.top_mm = landed.base_mm + self.height_mm;
        standing.push(landed);
        (collided, pushed)
    }
}

/// Pushes a box aside if nothing keeps it; whether it moved.
fn push(standing: &mut [Standing], which: usize, away: [f64; 2], depth_mm: f64, inner_mm: [f64; 2]) -> bool {
    let before = standing[which];
    let mut moved = before;
    moved.middle_mm = [0, 1].map(|axis| before.middle_mm[axis] + away[axis] * (depth_mm + TOUCH_MM));
    let is_loaded = |other: &Standing| other.base_mm >= before.top_mm - SOFT_MM && other.overlap(&before).is_some();
    let blocks = |other: &Standing| {
        other.top_mm > before.base_mm + SOFT_MM
            && other.base_mm < before.top_mm - SOFT_MM
            && other.overlap(&moved).is_some()
    };
    let is_kept = standing.iter().enumerate().any(|(at, other)| at != which && (is_loaded(other) || blocks(other)));
    let free = !is_kept && !moved.stay_inside(inner_mm);
    if free {
        standing[which] = moved;
    }
    free
}

impl Standing {
    /// The directions of its sides, as unit vectors.
    fn axes(&self) -> [[f64; 2]; 2] {
        // No box is turned by more than 45 degrees, where this is exact to 0.04 mm in a metre, and the same on every
        // machine.
        let angle = self.turn_rad;
        let sin = angle - angle.powi(3) / 6.0 + angle.powi(5) / 120.0;
        let cos = 1.0 - angle.powi(2) / 2.0 + angle.powi(4) / 24.0 - angle.powi(6) / 720.0;
        [[cos, sin], [-sin, cos]]
    }

    /// How far it reaches from its middle in a direction.
    fn reach(&self, direction: [f64; 2]) -> f64 {
        let [along, across] = self.axes().map(|axis| dot(axis, direction).abs());
        along * self.half_mm[0] + across * self.half_mm[1]
    }

    /// How deep two boxes are in each other seen from above, and the direction in which the other would have to give
    /// way; nothing if they only touch. (The separating axis of two rectangles is a side of one of them.)
    fn overlap(&self, other: &Self) -> Option<(f64, [f64; 2])> {
        let apart = [0, 1].map(|axis| other.middle_mm[axis] - self.middle_mm[axis]);
        let mut least = (f64::INFINITY, [0.0; 2]);
        for axis in self.axes().into_iter().chain(other.axes()) {
            let distance = dot(axis, apart);
            let depth = self.reach(axis) + other.reach(axis) - distance.abs();
            if depth <= TOUCH_MM {
                return None;
            }
            if depth < least.0 {
                least = (depth, if distance < 0.0 { axis.map(|part| -part) } else { axis });
            }
        }
        Some(least)
    }

    /// A wall guides it back inside; whether it had to.
    fn stay_inside(&mut self, inner_mm: [f64; 2]) -> bool {
        let mut touched = false;
        for (axis, direction) in [[1.0, 0.0], [0.0, 1.0]].into_iter().enumerate() {
            let reach = self.reach(direction);
            let range = reach.min(inner_mm[axis] / 2.0)..=(inner_mm[axis] - reach).max(inner_mm[axis] / 2.0);
            let inside = self.middle_mm[axis].clamp(*range.start(), *range.end());
            touched |= (inside - self.middle_mm[axis]).abs() > TOUCH_MM || 2.0 * reach > inner_mm[axis] + TOUCH_MM;
            self.middle_mm[axis] = inside;
        }
        touched
    }

    /// Whether the point lies under its top.
    #[must_use]
    pub(crate) fn covers(&self, x_mm: f64, y_mm: f64) -> bool {
        let from_middle = [x_mm - self.middle_mm[0], y_mm - self.middle_mm[1]];
        let [along, across] = self.axes().map(|axis| dot(axis, from_middle).abs());
        along < self.half_mm[0] && across < self.half_mm[1]
    }

    /// The rectangle along the walls around it: low and high corner [mm].
    pub(crate) fn bounds_mm(&self) -> [[f64; 2]; 2] {
        let reach = [[1.0, 0.0], [0.0, 1.0]].map(|direction| self.reach(direction));
        [[0, 1].map(|axis| self.middle_mm[axis] - reach[axis]), [0, 1].map(|axis| self.middle_mm[axis] + reach[axis])]
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth(imperfections: Imperfections) -> Truth {
        Truth::new(imperfections, ContainerSize::new(30, 30, 30, 10).unwrap(), 2)
    }

    fn set_down(truth: &mut Truth, id: u64, size_mm: [u32; 3], i: u16, j: u16, base: u16) -> Landing {
        let spec = BoxSpec::new(id, size_mm).unwrap();
        truth.set_down(&spec, spec.extent(10), Placement { slot: 0, yaw: Yaw::Deg0, i, j, base })
    }

    #[test]
    fn a_perfect_arm_touches_nothing() {
        let mut truth = truth(Imperfections::default());
        for (id, (i, j, base)) in (1..).zip([(0, 0, 0), (0, 10, 0), (10, 0, 0), (0, 0, 10), (20, 20, 0)]) {
            let landing = set_down(&mut truth, id, [100; 3], i, j, base);
            assert!(!landing.lost && !landing.collided && !landing.walls, "{landing:?}");
            assert_eq!((landing.pushed, landing.offset_mm), (0, [0.0; 2]));
        }
        assert_eq!(truth.height_mm(0, 50.0, 50.0), 200.0);
        assert_eq!(truth.height_mm(0, 50.0, 150.0), 100.0);
        assert_eq!(truth.height_mm(0, 150.0, 150.0), 0.0);
        assert_eq!(truth.height_mm(1, 50.0, 50.0), 0.0);
    }

    /// A box that covers 1 cm of a standing one comes to rest on its edge, 10 cm too high; the next is in its way too.
    #[test]
    fn a_box_set_down_into_another_lands_on_it() {
        let mut truth = truth(Imperfections::default());
        set_down(&mut truth, 1, [100; 3], 0, 0, 0);
        assert!(set_down(&mut truth, 2, [100; 3], 9, 0, 0).collided);
        assert_eq!(truth.slots()[0][1].base_mm, 100.0);
        assert!(set_down(&mut truth, 3, [50, 50, 50], 12, 2, 10).collided, "its place is taken by the one too high");
        assert!(!set_down(&mut truth, 4, [50, 50, 50], 12, 12, 0).collided);
    }

    /// The same arm, the same errors: only what boxes do then differs.
    #[test]
    fn rigid_boxes_err_like_those_that_stand() {
        let size = ContainerSize::new(30, 30, 30, 10).unwrap();
        let noisy = Imperfections { seed: 2, actuator_mm: 4.0, yaw_deg: 1.0, ..Imperfections::default() };
        let (mut standing, mut rigid) = (Truth::new(noisy, size, 2), Truth::rigid(noisy, size, 2));
        for (id, (i, j)) in (1..).zip([(2, 2), (2, 17), (17, 2), (17, 17)]) {
            let landings = [&mut standing, &mut rigid].map(|truth| set_down(truth, id, [100; 3], i, j, 0));
            assert!(landings.iter().all(|landing| !landing.lost && !landing.collided && !landing.restless));
            let [stands, lies] = landings.map(|landing| landing.offset_mm);
            assert!((stands[0] - lies[0]).hypot(stands[1] - lies[1]) < 0.5, "{stands:?} and {lies:?}");
        }
        for (stands, lies) in standing.slots()[0].iter().zip(&rigid.slots()[0]) {
            assert!((stands.turn_rad - lies.turn_rad).abs() < 1e-3 && (stands.top_mm - lies.top_mm).abs() < 0.5);
        }
        let matter = [&standing, &rigid].map(Truth::matter);
        assert!(!standing.go_on(&matter[1]) && !rigid.go_on(&matter[0]), "they are of two kinds");
        rigid.replace(0);
        assert_eq!((rigid.slots()[0].len(), rigid.matter()), (0, Matter::Lying(vec![Vec::new(); 2])));
        assert!(rigid.go_on(&matter[1]));
        assert_eq!(rigid.matter(), matter[1]);
    }

    #[test]
    fn a_box_gives_way_if_nothing_keeps_it() {
        let pushy = Imperfections { push_mm: 12.0, ..Imperfections::default() };
        let mut free = truth(pushy);
        set_down(&mut free, 1, [100; 3], 10, 0, 0);
        assert_eq!(set_down(&mut free, 2, [100; 3], 1, 0, 0).pushed, 1);
        let [pushed, landed] = free.slots()[0][..] else { panic!("two boxes stand there") };
        assert!((pushed.middle_mm[0] - 160.0).abs() < 1e-3 && landed.base_mm == 0.0, "{pushed:?}");
        let mut kept = truth(pushy);
        set_down(&mut kept, 1, [100; 3], 20, 0, 0);
        assert_eq!(set_down(&mut kept, 2, [100; 3], 11, 0, 0).pushed, 0, "the wall keeps it");
        let mut loaded = truth(pushy);
        set_down(&mut loaded, 1, [100; 3], 10, 0, 0);
        set_down(&mut loaded, 2, [50; 3], 12, 2, 10);
        assert_eq!(set_down(&mut loaded, 3, [100; 3], 1, 0, 0).pushed, 0, "a box stands on it");
    }

    #[test]
    fn errors_are_those_of_the_box_and_stay_in_their_bound() {
        let noisy = Imperfections { seed: 3, actuator_mm: 5.0, yaw_deg: 1.0, ..Imperfections::default() };
        let offsets = |_| (1..50).map(|id| set_down(&mut truth(noisy), id, [100; 3], 10, 10, 0).offset_mm);
        let first: Vec<_> = offsets(0).collect();
        assert_eq!(first, offsets(1).collect::<Vec<_>>());
        assert!(first.iter().flatten().all(|mm| mm.abs() <= 15.0));
        assert!(first.iter().flatten().any(|mm| mm.abs() > 5.0));
    }

    #[test]
    fn walls_hold() {
        let noisy = Imperfections { seed: 3, actuator_mm: 5.0, ..Imperfections::default() };
        let landings: Vec<_> = (1..40).map(|id| set_down(&mut truth(noisy), id, [100; 3], 0, 20, 0)).collect();
        assert!(landings.iter().all(|landing| landing.offset_mm[0] >= 0.0 && landing.offset_mm[1] <= 0.0));
        assert!(landings.iter().filter(|landing| landing.walls).count() > 20);
        assert!(!landings.iter().any(|landing| landing.collided), "a wall guides");
    }

    /// By hand: a square of 100 mm turned by 0.1 rad reaches 50 (cos 0.1 + sin 0.1) = 54.742 mm from its middle.
    #[test]
    fn a_turned_box_reaches_farther() {
        let turned =
            Standing { box_id: 1, middle_mm: [100.0; 2], half_mm: [50.0; 2], turn_rad: 0.1, base_mm: 0.0, top_mm: 9.0 };
        let other = |x: f64| Standing { turn_rad: 0.0, middle_mm: [x, 100.0], ..turned };
        assert!(turned.overlap(&other(204.74)).is_some());
        assert!(turned.overlap(&other(204.75)).is_none());
        assert!((turned.bounds_mm()[1][0] - 154.742).abs() < 1e-3);
    }

    #[test]
    fn boxes_are_lost_refused_and_measured_wrongly_as_often_as_stated() {
        let bad =
            Imperfections { drop_share: 0.2, refuse_share: 0.1, size_mm: 2.0, seed: 7, ..Imperfections::default() };
        let mut truth = truth(bad);
        let lost = (0..1000).filter(|&id| set_down(&mut truth, id, [10; 3], 0, 0, 0).lost).count();
        assert!((150..250).contains(&lost), "{lost} of 1000");
        assert_eq!(truth.slots()[0].len(), 1000 - lost);
        assert!((60..140).contains(&(0..1000).filter(|&order| truth.refuses(order)).count()));
        let spec = BoxSpec::new(9, [100, 200, 300]).unwrap();
        let measured = truth.measured(&spec);
        assert_ne!(measured, spec);
        assert!(measured.size_mm().iter().zip(spec.size_mm()).all(|(&mm, is)| mm.abs_diff(is) <= 6));
    }
}
