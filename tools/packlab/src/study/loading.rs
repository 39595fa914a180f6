//! One episode in a world where boxes do not land where they are told to.

use packing::{BoxSpec, ClosePolicy, Environment, Extent, Grid, Outcome, Placement, Rules, SizeError, Step, Yaw};
use physical::{Camera, Commanded, Fault, Fusion, Imperfections, Optics, Truth};

/// What an episode is loaded under.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct World {
    /// Fixes all errors.
    pub(crate) seed: u64,
    /// Standard deviation of where the arm sets a box down, along each axis [mm].
    pub(crate) actuator_mm: f64,
    /// What a box keeps free on each side [mm].
    pub(crate) clearance_mm: u16,
    /// Standard deviation of the camera's heights and of where it sees them [mm]; nothing for no camera.
    pub(crate) camera_mm: Option<f64>,
}

/// What came of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Loaded {
    pub(crate) outcome: Outcome,
    /// Boxes that touched another box on their way down, or whose place was taken.
    pub(crate) collisions: u32,
    /// Boxes that a wall had to guide inside.
    pub(crate) guided: u32,
    /// Boxes after which other heights were believed than those that were commanded.
    pub(crate) corrections: u32,
    /// Boxes after which the camera saw what nobody could explain.
    pub(crate) alarms: u32,
}

/// The frames of a look.
const FRAMES: usize = 5;

impl World {
    /// How far a box may be seen from where it was commanded to before the camera is believed [mm]: half a cell, or
    /// twice what the camera errs by.
    fn tolerance_mm(camera_mm: f64) -> f64 {
        (2.0 * camera_mm).max(5.0)
    }

    /// Loads the boxes where `choose` says, by what is believed at the time.
    pub(crate) fn load(
        &self,
        size: packing::ContainerSize,
        slots: usize,
        boxes: &[BoxSpec],
        optimum: Option<u32>,
        mut choose: impl FnMut(&Grid, Extent, usize) -> Option<Placement>,
    ) -> Result<Loaded, SizeError> {
        let Self { seed, actuator_mm, clearance_mm, camera_mm } = *self;
        let rules = Rules { clearance_mm, ..Rules::default() };
        let mut environment = Environment::on(Grid::with_rules(size, slots, rules)?, ClosePolicy::Fullest);
        let imperfections = Imperfections { seed, actuator_mm, ..Imperfections::default() };
        let mut truth = Truth::new(imperfections, size, slots);
        let mut eye = camera_mm.map(|camera_mm| {
            let (height_mm, shift_mm, dropout_share) = (camera_mm, camera_mm, 0.01);
            let (fault, fault_from, fault_looks) = (Fault::None, 0, 0);
            let optics = Optics { frames: FRAMES, height_mm, shift_mm, dropout_share, fault, fault_from, fault_looks };
            (Camera::new(optics, seed), Fusion::new(size, slots, Self::tolerance_mm(camera_mm)))
        });
        let (mut collisions, mut guided, mut corrections, mut alarms) = (0, 0, 0, 0);
        let mut containers: Vec<u32> = environment.grid().slots().iter().map(packing::Slot::container).collect();
        let mut before = Vec::new();
        for (index, spec) in boxes.iter().enumerate() {
            let step = environment.pack(spec, |grid, extent| {
                let choice = choose(grid, extent, index);
                if let Some(Placement { slot, .. }) = choice {
                    before.clear();
                    before.extend_from_slice(grid.slots()[usize::from(slot)].surface().heights());
                }
                choice
            });
            let Ok(Step::Placed(placement)) = step else { continue };
            let slot = placement.slot;
            let container = environment.grid().slots()[usize::from(slot)].container();
            if std::mem::replace(&mut containers[usize::from(slot)], container) != container {
                truth.replace(slot);
                eye.iter_mut().for_each(|(_, fusion)| fusion.replace(slot));
            }
            let room = environment.grid().extent(spec).turned(placement.yaw);
            let landing = truth.set_down(spec, room, placement);
            collisions += u32::from(landing.collided);
            guided += u32::from(landing.walls);
            let Some((camera, fusion)) = &mut eye else { continue };
            let [length, breadth, height] = spec.size_mm();
            let sides_mm =
                if placement.yaw == Yaw::Deg0 { [length, breadth, height] } else { [breadth, length, height] };
            let commanded = Commanded { box_id: spec.id(), placement, room, sides_mm };
            let mut heights = environment.grid().slots()[usize::from(slot)].surface().heights().to_vec();
            let look = camera.look(&truth, slot, spec.id());
            if let Ok(fused) = fusion.fuse(look, &commanded, &before, &mut heights) {
                if fused.is_corrected {
                    environment.correct(slot, &heights);
                }
                corrections += u32::from(fused.is_corrected);
                alarms += u32::from(fused.irreconcilable.is_some());
            }
        }
        Ok(Loaded { outcome: environment.outcome(optimum), collisions, guided, corrections, alarms })
    }
}
