//! Looking at a cell that runs as another user.

use std::os::unix::process::CommandExt as _;
use std::process::Command;

use anyhow::Context as _;
use runtime::{BusConfig, BusOwner};
use rustix::process::geteuid;

/// Goes on as the user to whom the bus belongs, if this is root; does nothing if it is nobody's or one's own.
///
/// Root may do everything, but a file that root makes on the bus would be one that the cell cannot use. So the same
/// command line is run again, by the owner. Whoever is neither root nor the owner is told so by the bus.
pub(crate) fn act_as_owner(config: &BusConfig) -> anyhow::Result<()> {
    match BusOwner::of(config)? {
        Some(owner) if geteuid().is_root() && !owner.is_me() => {
            let own = std::env::current_exe().context("cannot tell where packcell lies")?;
            let mut again = Command::new(own);
            again.args(std::env::args_os().skip(1)).uid(owner.uid).gid(owner.gid);
            let failure = again.exec();
            Err(failure).with_context(|| format!("cannot go on as {}, to whom the bus belongs", owner.name))
        }
        _ => Ok(()),
    }
}
