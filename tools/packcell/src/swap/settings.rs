//! The files by which a scorer instance keeps its own model, whatever becomes of the file it came from.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, bail};
use messages::Instance;
use messages::topics::Role;
use runtime::{Config, ScorerConfig, StateConfig};

use crate::cell::program_path;

/// Gives an instance these settings and a copy of its model.
pub(crate) fn install(state: &StateConfig, instance: Instance, mut settings: ScorerConfig) -> anyhow::Result<()> {
    if !settings.model.as_os_str().is_empty() {
        let copy = state.dir.join(format!("model-{instance}.safetensors"));
        if settings.model != copy {
            let model = fs::read(&settings.model);
            let model = model.with_context(|| format!("cannot read the model {}", settings.model.display()))?;
            replace(&copy, &model)?;
            settings.model = copy;
        }
    }
    let text = toml::to_string(&settings).context("scorer settings")?;
    replace(&state.scorer(instance), text.as_bytes())
}

/// Where the settings are kept to which `--back` returns.
pub(crate) fn previous(state: &StateConfig) -> PathBuf {
    state.dir.join("scorer-previous.toml")
}

/// Takes an instance's settings away, and keeps them for `--back`.
pub(crate) fn put_aside(config: &Config, instance: Instance) -> anyhow::Result<()> {
    let settings = config.scorer_instance(instance)?;
    replace(&previous(&config.state), toml::to_string(&settings).context("scorer settings")?.as_bytes())?;
    remove(&config.state, instance)
}

/// Takes an instance's settings away.
pub(crate) fn remove(state: &StateConfig, instance: Instance) -> anyhow::Result<()> {
    let path = state.scorer(instance);
    match fs::remove_file(&path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}

/// Lets the scorer's own program say whether an instance can run with its settings.
pub(crate) fn check(config_file: &Path, state: &StateConfig, instance: Instance) -> anyhow::Result<()> {
    let state_dir = format!("state.dir={}", state.dir.display());
    let output = Command::new(program_path(Role::Scorer.name())?)
        .arg("--config")
        .arg(config_file)
        .args(["--set", &state_dir, "--check", "--instance", &instance.to_string()])
        .stdin(Stdio::null())
        .output()
        .context("cannot run the scorer")?;
    if output.status.success() {
        Ok(())
    } else {
        bail!("the new scorer cannot be used: {}", String::from_utf8_lossy(&output.stderr).trim())
    }
}

/// Replaces a file whole: whoever reads it finds the old one or the new one.
fn replace(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let unfinished = path.with_extension("new");
    let write = || {
        let mut file = File::create(&unfinished)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&unfinished, path)
    };
    write().with_context(|| format!("cannot write {}", path.display()))
}
