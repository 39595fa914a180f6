//! Where a cell of the soak's own lives.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context as _, bail};
use runtime::Config;

use crate::private_bus::PrivateBus;
use crate::up::own_state_dir;

/// A bus, and a directory on a disk for the state. Dropping it removes both, the directory only if nobody named it.
#[derive(Debug)]
pub(crate) struct Place {
    _bus: PrivateBus,
    own_state: Option<PathBuf>,
}

impl Place {
    /// A place for a cell of this configuration, which is told where that is.
    pub(crate) fn make(config: &mut Config, names_state: bool) -> anyhow::Result<Self> {
        let bus = PrivateBus::new()?;
        config.bus = bus.config().clone();
        if names_state {
            if config.state.journal().exists() || config.state.world().exists() {
                let dir = config.state.dir.display();
                bail!(
                    "{dir} (state.dir) holds the state of a cell: a soak begins with a new one, name another directory"
                );
            }
            return Ok(Self { _bus: bus, own_state: None });
        }
        // Beside the state of real cells, and not in memory: the journal's disk is part of what is soaked.
        let dir = own_state_dir()?.with_file_name(format!("packcell-soak-{}", std::process::id()));
        fs::create_dir_all(&dir).with_context(|| format!("cannot create {}", dir.display()))?;
        config.state.dir.clone_from(&dir);
        Ok(Self { _bus: bus, own_state: Some(dir) })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if let Some(dir) = &self.own_state {
            let _what_is_gone_is_gone = fs::remove_dir_all(dir);
        }
    }
}
