//! Boxes as rigid bodies: they slide, tilt and fall until they lie still.
//!
//! Nothing of the engine outlives a motion. Every box begins from its pose at rest, so that the poses are all there is to
//! keep, and whoever goes on from them goes on exactly. The engine calculates in metres and single precision, in one
//! order and with its own sines: the same boxes come to lie the same, bit for bit.

use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::na::{ComplexField, RealField};
use rapier3d::prelude::{
    ColliderBuilder, IntegrationParameters, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle, SpringCoefficients,
};

use packing::ContainerSize;
use serde::{Deserialize, Serialize};

use crate::truth::{Brought, SOFT_MM, Standing, inner_mm};

/// Friction of cardboard on cardboard and on the container [-].
const FRICTION: f32 = 0.5;

/// Mean density of a parcel [kg/m3]. All boxes have the same, so it decides nothing but how hard they push.
const DENSITY: f32 = 200.0;

/// Gravity [m/s2].
const GRAVITY: f32 = 9.81;

/// One step of the simulation [s].
const STEP_S: f32 = 1.0 / 120.0;

/// Iterations of the contact solver in one step: four times the engine's own number. With half as many, slender stacks
/// that stand alone rock for ever.
const ITERATIONS: usize = 16;

/// How stiff contacts are, as the frequency and damping ratio of a spring [Hz, -]. A stack of ten cubes of 100 mm sinks
/// into itself by about 1.4 mm then. At the engine's own 30 Hz it fell over, and from 300 Hz on it did not come to rest
/// (with half the iterations).
const STIFFNESS_HZ: f32 = 120.0;
const DAMPING: f32 = 10.0;

/// Slower than this, for [`REST_S`], a box lies still [m/s].
const REST_M_PER_S: f32 = 0.004;

/// See [`REST_M_PER_S`] [s].
const REST_S: f32 = 0.3;

/// Steps after which boxes that do not come to rest are left as they are, which is reported: ten seconds.
const STEPS_MAX: u32 = 1200;

/// A box no corner of which a motion moves farther than this stays exactly where it was [mm]: what sticks does not creep,
/// however often another box is set down.
const CREEP_MM: f64 = 0.2;

/// Cardboard that is grazed by less than this on the way down gives way, and is not touched [mm].
const GRAZE_MM: f64 = 0.5;

/// How long a shaken container is accelerated in each direction [s].
const SHAKE_S: f32 = 0.5;

/// A box that a shaking brings farther than this has shifted [mm].
const SHIFTED_MM: f64 = 20.0;

/// Thickness of walls and floor [m]: what leaves a container comes to rest on a wall.
const WALL_M: f32 = 1.0;

/// A direction that is shorter than this is none: it comes of two edges that are parallel, but for the rounding of their
/// turns [-].
const PARALLEL: f64 = 1e-4;

const MM_PER_M: f64 = 1000.0;

/// A box as it lies, level or not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lying {
    /// The box's identity.
    pub box_id: u64,
    /// Half its sides along its own axes, which are those of the container before it is turned [mm].
    pub half_mm: [f64; 3],
    /// Its middle [mm].
    pub middle_mm: [f64; 3],
    /// How it is turned: the unit quaternion `x, y, z, w`.
    pub turn: [f64; 4],
}

/// A container in which boxes are rigid bodies.
#[derive(Clone, Debug)]
pub struct RigidContainer {
    inner_mm: [f64; 3],
    lying: Vec<Lying>,
}

/// How it went when a box was set down among rigid ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Settled {
    /// The box where the arm let go of it: at the first thing it touched.
    pub let_go: Lying,
    /// That was another box more than 5 mm above where its base was meant to be.
    pub collided: bool,
    /// It still is in the container.
    pub stays: bool,
    /// Other boxes whose middle moved by more than [`Fate::MOVED_MM`].
    pub pushed: u32,
    /// All boxes came to rest within ten seconds.
    pub is_at_rest: bool,
}

/// What became of a box since the arm let go of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fate {
    /// Its middle is more than [`Fate::MOVED_MM`] aside.
    pub moved: bool,
    /// It is more than [`Fate::TILTED_DEG`] off the level.
    pub tilted: bool,
    /// It came down by more than half its height, or left the container.
    pub fell: bool,
}

impl Fate {
    /// See [`Fate::moved`] [mm].
    pub const MOVED_MM: f64 = 5.0;

    /// See [`Fate::tilted`] [degrees].
    pub const TILTED_DEG: f64 = 5.0;

    /// The cosine of [`Fate::TILTED_DEG`].
    const TILTED_COS: f64 = 0.996_194_698_091_745_5;

    /// What became of a box that was let go there and lies here now; nothing for one that left the container.
    #[must_use]
    pub fn of(let_go: &Lying, lies: Option<&Lying>) -> Self {
        let Some(lies) = lies else { return Self { moved: true, tilted: false, fell: true } };
        let [x, y, z] = [0, 1, 2].map(|axis| lies.middle_mm[axis] - let_go.middle_mm[axis]);
        Self {
            moved: x * x + y * y > Self::MOVED_MM * Self::MOVED_MM,
            tilted: lies.axes()[2][2] < Self::TILTED_COS,
            fell: -z > let_go.half_mm[2],
        }
    }

    /// What became of it by then and since.
    #[must_use]
    pub fn and(self, later: Self) -> Self {
        Self { moved: self.moved || later.moved, tilted: self.tilted || later.tilted, fell: self.fell || later.fell }
    }
}

impl Lying {
    /// A box that stands level.
    pub(crate) fn of(standing: &Standing) -> Self {
        let Standing { box_id, middle_mm: [x_mm, y_mm], half_mm: [along_mm, across_mm], .. } = *standing;
        let half_z_mm = (standing.top_mm - standing.base_mm) / 2.0;
        let turn = Rotation::from_rotation_z(standing.turn_rad as f32).to_array().map(f64::from);
        Self {
            box_id,
            half_mm: [along_mm, across_mm, half_z_mm],
            middle_mm: [x_mm, y_mm, standing.base_mm + half_z_mm],
            turn,
        }
    }

    /// What can be seen of it from above: of a box that lies askew, the level one around it, as high as its highest
    /// corner.
    #[must_use]
    pub fn standing(&self) -> Standing {
        let axes = self.axes();
        // A side that is not the steepest has a direction on the floor.
        let steepest = (1..3).fold(0, |most, axis| if axes[axis][2].abs() > axes[most][2].abs() { axis } else { most });
        let [x, y, _] = axes[(steepest + 1) % 3];
        let length = (x * x + y * y).sqrt();
        let (x, y) = if x.abs() < y.abs() { (y / length, -x / length) } else { (x / length, y / length) };
        let (x, y) = if x < 0.0 { (-x, -y) } else { (x, y) };
        let [middle_x_mm, middle_y_mm, middle_z_mm] = self.middle_mm;
        let half_z_mm = self.reach([0.0, 0.0, 1.0]);
        Standing {
            box_id: self.box_id,
            middle_mm: [middle_x_mm, middle_y_mm],
            half_mm: [self.reach([x, y, 0.0]), self.reach([-y, x, 0.0])],
            turn_rad: RealField::atan2(y, x),
            base_mm: middle_z_mm - half_z_mm,
            top_mm: middle_z_mm + half_z_mm,
        }
    }

    /// Its corners [mm]: bit 0, 1 and 2 of the index say on which end of its own axes each lies.
    #[must_use]
    pub fn corners_mm(&self) -> [[f64; 3]; 8] {
        let axes = self.axes();
        std::array::from_fn(|corner| {
            let sides = [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 } * self.half_mm[axis]);
            [0, 1, 2].map(|to| self.middle_mm[to] + (0..3).map(|axis| sides[axis] * axes[axis][to]).sum::<f64>())
        })
    }

    /// How far it is off the level [degrees]: 0 as it was set down, 90 on its side.
    #[must_use]
    pub fn tilt_deg(&self) -> f64 {
        ComplexField::acos(self.axes()[2][2].clamp(-1.0, 1.0)).to_degrees()
    }

    /// The directions of its own axes, as unit vectors.
    fn axes(&self) -> [[f64; 3]; 3] {
        let length = self.turn.iter().map(|part| part * part).sum::<f64>().sqrt();
        let [x, y, z, w] = self.turn.map(|part| part / length);
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)],
            [2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)],
            [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    }

    /// How far it must be lifted to clear another, if that is in its way when it is lowered from above [mm].
    ///
    /// Two cuboids are apart if they are so along a side of one of them or across an edge of each. Each of these
    /// directions leaves an interval of lifts in which they are not; in all of them together, they meet.
    fn lift_mm(&self, other: &Self) -> Option<f64> {
        let (own, others) = (self.axes(), other.axes());
        let across = own.iter().flat_map(|&a| others.map(|b| cross(a, b)));
        let apart_mm = [0, 1, 2].map(|axis| other.middle_mm[axis] - self.middle_mm[axis]);
        let (mut low_mm, mut high_mm) = (f64::NEG_INFINITY, f64::INFINITY);
        for direction in own.into_iter().chain(others).chain(across) {
            let (middle_mm, reach_mm) = (dot(apart_mm, direction), self.reach(direction) + other.reach(direction));
            if direction[2].abs() > PARALLEL {
                let ends_mm = [middle_mm - reach_mm, middle_mm + reach_mm].map(|mm| mm / direction[2]);
                low_mm = low_mm.max(ends_mm[0].min(ends_mm[1]));
                high_mm = high_mm.min(ends_mm[0].max(ends_mm[1]));
            } else if dot(direction, direction) > PARALLEL && middle_mm.abs() >= reach_mm {
                return None;
            }
        }
        (low_mm < high_mm).then_some(high_mm)
    }

    /// How far it reaches from its middle in a direction.
    fn reach(&self, direction: [f64; 3]) -> f64 {
        let along = self.axes().map(|axis| dot(axis, direction).abs());
        (0..3).map(|axis| along[axis] * self.half_mm[axis]).sum()
    }

    fn pose(&self) -> Pose {
        let [x, y, z, w] = self.turn.map(|part| part as f32);
        Pose::from_parts(metres(self.middle_mm), Rotation::from_xyzw(x, y, z, w))
    }

    /// The same box in another pose.
    fn at(&self, pose: &Pose) -> Self {
        let middle_mm = pose.translation.to_array().map(|m| f64::from(m) * MM_PER_M);
        Self { middle_mm, turn: pose.rotation.to_array().map(f64::from), ..*self }
    }

    /// How far the corner is that has moved farthest between two poses of one box.
    fn farthest_mm(&self, other: &Self) -> f64 {
        let corners = self.corners_mm().into_iter().zip(other.corners_mm());
        corners.map(|(one, other)| distance_mm(one, other)).fold(0.0, f64::max)
    }
}

fn distance_mm(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn metres(mm: [f64; 3]) -> Vector {
    Vector::from_array(mm.map(|mm| (mm / MM_PER_M) as f32))
}

impl RigidContainer {
    /// An empty container.
    #[must_use]
    pub fn new(size: ContainerSize) -> Self {
        let [length_mm, breadth_mm] = inner_mm(size);
        let height_mm = f64::from(size.height()) * f64::from(size.cell_mm());
        Self { inner_mm: [length_mm, breadth_mm, height_mm], lying: Vec::new() }
    }

    /// The boxes that lie in it, in the order they came.
    #[must_use]
    pub fn lying(&self) -> &[Lying] {
        &self.lying
    }

    /// Goes on with these boxes in place of those that lie in it.
    pub fn go_on(&mut self, lying: &[Lying]) {
        self.lying.clear();
        self.lying.extend_from_slice(lying);
    }

    /// One more box lies there, and nothing moves.
    pub(crate) fn add(&mut self, lying: Lying) {
        self.lying.push(lying);
    }

    /// The arm lowers a box straight down, lets go where it first touches something, and all boxes come to rest. What
    /// falls over the walls is gone.
    pub fn set_down(&mut self, brought: &Brought) -> Settled {
        let base_mm = self.first_touch_mm(brought);
        let let_go = Lying::of(&Standing { base_mm, top_mm: base_mm + brought.height_mm, ..brought.held });
        let before = self.lying.clone();
        self.lying.push(let_go);
        let (mut world, bodies) = self.world();
        let is_at_rest = settle(&mut world, &bodies);
        let after: Vec<_> =
            self.lying.iter().zip(&bodies).map(|(lying, &body)| self.read(&world, lying, body)).collect();
        let is_pushed = |(before, after): &(&Lying, &Option<Lying>)| Fate::of(before, after.as_ref()).moved;
        let pushed = before.iter().zip(&after).filter(is_pushed).count() as u32;
        let stays = after.last().is_some_and(Option::is_some);
        self.lying = after.into_iter().flatten().collect();
        Settled { let_go, collided: base_mm > brought.planned_mm + SOFT_MM, stays, pushed, is_at_rest }
    }

    /// How many of its boxes shift by more than 20 mm, or leave it, if it is accelerated sideways for half a second, in
    /// one of the four directions or another, each time from how they lie now.
    ///
    /// `acceleration_g` is in parts of gravity [-].
    #[must_use]
    pub fn shifted_by_shaking(&self, acceleration_g: f64) -> usize {
        let mut shifted = vec![false; self.lying.len()];
        let sideways = acceleration_g as f32 * GRAVITY;
        for direction in [Vector::X, Vector::NEG_X, Vector::Y, Vector::NEG_Y] {
            let (mut world, bodies) = self.world();
            world.gravity += direction * sideways;
            for _ in 0..(SHAKE_S / STEP_S) as u32 {
                world.step();
            }
            world.gravity -= direction * sideways;
            world.wake_up_all(true);
            settle(&mut world, &bodies);
            for ((lying, &body), shifted) in self.lying.iter().zip(&bodies).zip(&mut shifted) {
                let now = self.read(&world, lying, body);
                *shifted |= now.is_none_or(|now| distance_mm(now.middle_mm, lying.middle_mm) > SHIFTED_MM);
            }
        }
        shifted.into_iter().filter(|&shifted| shifted).count()
    }

    /// The height of the base at which a box that is lowered touches something first [mm].
    fn first_touch_mm(&self, brought: &Brought) -> f64 {
        let mut held = Lying::of(&Standing { base_mm: 0.0, top_mm: brought.height_mm, ..brought.held });
        for half_mm in &mut held.half_mm[..2] {
            *half_mm = (*half_mm - GRAZE_MM).max(GRAZE_MM);
        }
        self.lying.iter().filter_map(|other| held.lift_mm(other)).fold(0.0, f64::max)
    }

    /// Floor, walls and all boxes where they lie, with no speed.
    fn world(&self) -> (PhysicsWorld, Vec<RigidBodyHandle>) {
        let mut world = PhysicsWorld { gravity: Vector::NEG_Z * GRAVITY, ..PhysicsWorld::default() };
        let stiff = SpringCoefficients::new(STIFFNESS_HZ, DAMPING);
        world.integration_parameters = IntegrationParameters {
            dt: STEP_S,
            num_solver_iterations: ITERATIONS,
            contact_softness: stiff,
            static_contact_softness: stiff,
            // It would go on with contacts as they were up to 50 mm ago, which is as long as a box.
            contact_recycling: false,
            ..IntegrationParameters::default()
        };
        let [length, breadth, height] = metres(self.inner_mm).to_array();
        let mut wall = |low: [f32; 3], high: [f32; 3]| {
            let half = [0, 1, 2].map(|axis| (high[axis] - low[axis]) / 2.0);
            let middle = Vector::from_array([0, 1, 2].map(|axis| (high[axis] + low[axis]) / 2.0));
            let slab = ColliderBuilder::cuboid(half[0], half[1], half[2]).translation(middle).friction(FRICTION);
            world.insert_collider(slab, None);
        };
        wall([-WALL_M, -WALL_M, -WALL_M], [length + WALL_M, breadth + WALL_M, 0.0]);
        wall([-WALL_M, -WALL_M, 0.0], [0.0, breadth + WALL_M, height]);
        wall([length, -WALL_M, 0.0], [length + WALL_M, breadth + WALL_M, height]);
        wall([0.0, -WALL_M, 0.0], [length, 0.0, height]);
        wall([0.0, breadth, 0.0], [length, breadth + WALL_M, height]);
        let insert = |lying: &Lying| {
            let [along, across, up] = metres(lying.half_mm).to_array();
            let shape = ColliderBuilder::cuboid(along, across, up).friction(FRICTION).density(DENSITY);
            let (body, _) = world.insert(RigidBodyBuilder::dynamic().pose(lying.pose()), shape);
            let activation = world.bodies[body].activation_mut();
            // The engine calls a body still that is slower than twice its threshold.
            (activation.normalized_linear_threshold, activation.time_until_sleep) = (REST_M_PER_S / 2.0, REST_S);
            body
        };
        let bodies = self.lying.iter().map(insert).collect();
        (world, bodies)
    }

    /// The box as it lies now, unless it left the container.
    fn read(&self, world: &PhysicsWorld, lying: &Lying, body: RigidBodyHandle) -> Option<Lying> {
        let now = lying.at(world.bodies[body].position());
        if now.farthest_mm(lying) < CREEP_MM {
            return Some(*lying);
        }
        let is_inside = |axis: usize| (0.0..=self.inner_mm[axis]).contains(&now.middle_mm[axis]);
        (is_inside(0) && is_inside(1) && now.middle_mm[2].is_finite()).then_some(now)
    }
}

/// Steps until everything lies still; whether it does.
fn settle(world: &mut PhysicsWorld, bodies: &[RigidBodyHandle]) -> bool {
    (0..STEPS_MAX).any(|_| {
        world.step();
        bodies.iter().all(|&body| world.bodies[body].is_sleeping())
    })
}

#[cfg(test)]
mod tests;
