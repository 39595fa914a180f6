//! The true world beside what is believed of it, and the camera between them.
//!
//! Off by default: then boxes stand where the arm was told to put them, and that is believed. What is published never
//! comes from the truth but through the camera. In a world of physics the arm's motion ends when all boxes lie still.

use std::collections::BTreeMap;

use packing::{BoxSpec, Grid, Placement, Yaw};
use physical::{Blind, Camera, Commanded, Fault, Fused, Fusion, Imperfections, Irreconcilable, Matter, Optics, Truth};
use runtime::{BeliefSource, CameraFault, Config, WithoutCamera, WorldKind};

/// The true world, and what sees it.
#[derive(Debug)]
pub struct Reality {
    truth: Truth,
    eye: Option<Eye>,
}

/// The camera, and what is made of its looks.
#[derive(Debug)]
struct Eye {
    camera: Camera,
    fusion: Fusion,
    without: WithoutCamera,
    /// Why the last look was not trusted, and what it was to look at.
    blind: Option<(Blind, Unseen)>,
    /// What could not be explained, by slot, until its container leaves.
    irreconcilable: BTreeMap<u16, Irreconcilable>,
}

/// A box that was set down and not looked at.
#[derive(Clone, Debug)]
struct Unseen {
    commanded: Commanded,
    /// The heights of its container before it [cells].
    before: Vec<u16>,
}

impl Reality {
    /// What the configuration asks for; nothing if boxes stand where they are put and that is believed.
    #[must_use]
    pub fn of(config: &Config, grid: &Grid) -> Option<Self> {
        let (world, belief) = (&config.world, &config.belief);
        let imperfections = Imperfections {
            seed: world.seed,
            actuator_mm: world.actuator_mm,
            yaw_deg: world.yaw_deg,
            size_mm: world.size_mm,
            refuse_share: world.refuse_share,
            drop_share: world.drop_share,
            push_mm: world.push_mm,
        };
        let (size, slots) = (grid.size(), grid.slots().len());
        let optics = Optics {
            frames: belief.frames,
            height_mm: world.camera_mm,
            shift_mm: world.camera_shift_mm,
            dropout_share: world.camera_dropout_share,
            fault: match world.camera_fault {
                CameraFault::None => Fault::None,
                CameraFault::NotANumber => Fault::NotANumber,
                CameraFault::Infinite => Fault::Infinite,
                CameraFault::WrongSize => Fault::WrongSize,
                CameraFault::Frozen => Fault::Frozen,
                CameraFault::Away => Fault::Away,
            },
            fault_from: world.camera_fault_from,
            fault_looks: world.camera_fault_looks,
        };
        let eye = (belief.source == BeliefSource::Camera).then(|| Eye {
            camera: Camera::new(optics, world.seed),
            fusion: Fusion::new(size, slots, f64::from(belief.tolerance_mm)),
            without: belief.without_camera,
            blind: None,
            irreconcilable: BTreeMap::new(),
        });
        let is_imperfect = imperfections != Imperfections { seed: world.seed, ..Imperfections::default() };
        let truth = match world.kind {
            WorldKind::Physics => Truth::rigid(imperfections, size, slots),
            WorldKind::Geometric if is_imperfect || eye.is_some() => Truth::new(imperfections, size, slots),
            WorldKind::Geometric => return None,
        };
        Some(Self { truth, eye })
    }

    /// The true boxes, which must outlive the process.
    pub(crate) fn matter(&self) -> Matter {
        self.truth.matter()
    }

    /// Goes on from boxes that are there; whether they are of such a world with as many slots.
    pub(crate) fn go_on(&mut self, matter: &Matter) -> bool {
        self.truth.go_on(matter)
    }

    /// The box as it is measured at the pick.
    pub(crate) fn measured(&self, spec: &BoxSpec) -> BoxSpec {
        self.truth.measured(spec)
    }

    /// Whether the arm refuses this order.
    pub(crate) fn refuses(&self, order: u64) -> bool {
        self.truth.refuses(order)
    }

    /// The arm has set `real` down, which was measured and commanded as `spec`; `before` are the heights of its container
    /// before that, and `grid` believes that it stands where it was commanded to. Afterwards it believes what is seen.
    pub(crate) fn set_down(
        &mut self,
        real: &BoxSpec,
        spec: &BoxSpec,
        placement: Placement,
        before: Vec<u16>,
        grid: &mut Grid,
    ) {
        let room = grid.extent(spec).turned(placement.yaw);
        let landing = self.truth.set_down(real, room, placement);
        if landing.lost || landing.collided || landing.restless {
            let (box_id, lost, pushed, restless) = (spec.id(), landing.lost, landing.pushed, landing.restless);
            tracing::warn!(
                box_id,
                lost,
                pushed,
                restless,
                "the true world: a box collided, was lost or does not lie still"
            );
        }
        let [length_mm, breadth_mm, height_mm] = spec.size_mm();
        let sides_mm = match placement.yaw {
            Yaw::Deg0 => [length_mm, breadth_mm, height_mm],
            Yaw::Deg90 => [breadth_mm, length_mm, height_mm],
        };
        let commanded = Commanded { box_id: spec.id(), placement, room, sides_mm };
        if let Some(eye) = &mut self.eye {
            eye.look(&self.truth, Unseen { commanded, before }, grid);
        }
    }

    /// Looks again at what could not be seen, if boxes are not to be taken without a camera; whether they may be taken.
    pub(crate) fn may_take_boxes(&mut self, grid: &mut Grid) -> bool {
        let Some(eye) = &mut self.eye else { return true };
        if eye.without == WithoutCamera::Stop
            && let Some((_, unseen)) = eye.blind.take()
        {
            eye.look(&self.truth, unseen, grid);
            return eye.blind.is_none();
        }
        true
    }

    /// The container of this slot left, and an empty one came.
    pub(crate) fn replace(&mut self, slot: u16) {
        self.truth.replace(slot);
        if let Some(eye) = &mut self.eye {
            eye.fusion.replace(slot);
            eye.irreconcilable.remove(&slot);
            eye.blind.take_if(|(_, unseen)| unseen.commanded.placement.slot == slot);
        }
    }

    /// What a person should know, if anything.
    pub(crate) fn alarm(&self) -> Option<String> {
        let eye = self.eye.as_ref()?;
        let blind = eye.blind.as_ref().map(|(blind, _)| match eye.without {
            WithoutCamera::GoOn => format!("{blind}; what was commanded is believed without it"),
            WithoutCamera::Stop => format!("{blind}; no box is taken until it sees (belief.without_camera)"),
        });
        let first = || eye.irreconcilable.values().next().map(ToString::to_string);
        blind.or_else(first)
    }
}

impl Eye {
    fn look(&mut self, truth: &Truth, unseen: Unseen, grid: &mut Grid) {
        let Commanded { box_id, placement: Placement { slot, .. }, .. } = unseen.commanded;
        let look = self.camera.look(truth, slot, box_id);
        let Some(state) = grid.slots().get(usize::from(slot)) else { return };
        let mut heights = state.surface().heights().to_vec();
        match self.fusion.fuse(look, &unseen.commanded, &unseen.before, &mut heights) {
            Ok(Fused { is_corrected, irreconcilable, .. }) => {
                self.blind = None;
                if is_corrected {
                    grid.correct(slot, &heights);
                }
                self.irreconcilable.extend(irreconcilable.map(|what| (slot, what)));
            }
            Err(blind) => self.blind = Some((blind, unseen)),
        }
    }
}
