//! Where a cell of the soak's own lives.

use anyhow::bail;
use runtime::Config;

use crate::private_bus::PrivateBus;

/// A bus of its own for a cell of this configuration, which is told where that is. The state lies beside the bus, in
/// memory, unless a directory for it was named: on a disk the stub, which keeps its world at every box, would wait for
/// the disk, and the cell with it.
pub(crate) fn make(config: &mut Config, names_state: bool) -> anyhow::Result<PrivateBus> {
    let bus = PrivateBus::new()?;
    config.bus = bus.config().clone();
    if !names_state {
        config.state.dir = config.bus.root_dir.join("state");
    } else if config.state.journal().exists() || config.state.world().exists() {
        let dir = config.state.dir.display();
        bail!("{dir} (state.dir) holds the state of a cell: a soak begins with a new one, name another directory");
    }
    Ok(bus)
}
