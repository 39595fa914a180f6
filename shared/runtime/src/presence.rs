//! Who may be on a bus, and who is.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use iceoryx2::config::Config as IceoryxConfig;
use iceoryx2::node::{Node, NodeState};
use iceoryx2::prelude::{CallbackProgression, FilePath, SemanticString as _, ipc};

use crate::{BusConfig, BusError};

/// The user to whom a bus belongs. All processes of a cell are of this one user: iceoryx2 makes what it shares readable
/// and writable for nobody else.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusOwner {
    /// User id.
    pub uid: u32,
    /// Group id.
    pub gid: u32,
    /// Login name, or the user id where there is none.
    pub name: String,
}

impl BusOwner {
    /// Whose bus it is; nobody's as long as its directory does not exist.
    ///
    /// # Errors
    /// [`BusError::RootDir`] if the directory cannot be looked at.
    pub fn of(config: &BusConfig) -> Result<Option<Self>, BusError> {
        match fs::metadata(&config.root_dir) {
            Ok(state) => Ok(Some(Self { uid: state.uid(), gid: state.gid(), name: login_name(state.uid()) })),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(BusError::RootDir { path: config.root_dir.clone(), source }),
        }
    }

    /// Refuses a bus of another user, on which even root would leave files that its processes cannot use.
    ///
    /// # Errors
    /// [`BusError::Foreign`] says whose it is.
    pub(crate) fn require_me(config: &BusConfig) -> Result<(), BusError> {
        match Self::of(config)? {
            Some(owner) if !owner.is_me() => {
                Err(BusError::Foreign { path: config.root_dir.clone(), owner: owner.name })
            }
            _ => Ok(()),
        }
    }

    /// Whether it is the user of this process.
    #[must_use]
    pub fn is_me(&self) -> bool {
        self.uid == rustix::process::geteuid().as_raw()
    }
}

/// How many living processes are on a bus.
///
/// # Errors
/// [`BusError`] if the bus cannot be looked at, or belongs to another user.
pub fn processes_on(config: &BusConfig) -> Result<usize, BusError> {
    BusOwner::require_me(config)?;
    let settings = config.root_dir.join("iceoryx2.toml");
    if !settings.exists() {
        return Ok(0);
    }
    let failed = |reason: &dyn std::fmt::Debug| BusError::Iceoryx {
        action: "look at",
        name: "the processes",
        root_dir: config.root_dir.clone(),
        reason: format!("{reason:?}"),
    };
    let file = FilePath::new(settings.as_os_str().as_encoded_bytes()).map_err(|error| failed(&error))?;
    let iceoryx = IceoryxConfig::from_file(&file).map_err(|error| failed(&error))?;
    let mut living = 0;
    Node::<ipc::Service>::list(&iceoryx, |node| {
        living += usize::from(matches!(node, NodeState::Alive(_)));
        CallbackProgression::Continue
    })
    .map_err(|error| failed(&error))?;
    Ok(living)
}

fn login_name(uid: u32) -> String {
    let users = fs::read_to_string(Path::new("/etc/passwd")).unwrap_or_default();
    name_in(&users, uid).unwrap_or_else(|| uid.to_string())
}

fn name_in(users: &str, uid: u32) -> Option<String> {
    let mut entries = users.lines().map(|line| line.split(':').collect::<Vec<_>>());
    entries.find(|fields| fields.get(2).is_some_and(|id| *id == uid.to_string())).map(|fields| fields[0].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bus_belongs_to_the_owner_of_its_directory() {
        let dir = tempfile::tempdir().unwrap();
        let config = |root_dir: &Path| BusConfig { root_dir: root_dir.into(), prefix: "x_".into() };
        assert!(BusOwner::of(&config(dir.path())).unwrap().unwrap().is_me());
        assert_eq!(BusOwner::of(&config(&dir.path().join("none"))).unwrap(), None);
        assert_eq!(processes_on(&config(dir.path())).unwrap(), 0);
    }

    #[test]
    fn users_have_names() {
        let users = "root:x:0:0:root:/root:/bin/bash\npackcell:x:998:998::/:/usr/sbin/nologin\nbroken\n";
        assert_eq!(name_in(users, 998).as_deref(), Some("packcell"));
        assert_eq!(name_in(users, 5), None);
    }
}
