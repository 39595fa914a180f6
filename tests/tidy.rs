//! The rules of the tree.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::harness::root;

/// Who may import whom: a crate of ours, and those of ours that it may depend on.
const MAY_IMPORT: [(&str, &[&str]); 16] = [
    ("shared/packing", &[]),
    ("shared/dataset", &["packing"]),
    ("shared/policy", &["packing"]),
    ("shared/report", &["packing"]),
    ("shared/physical", &["packing"]),
    ("shared/messages", &["packing"]),
    ("shared/journal", &["messages"]),
    ("shared/runtime", &["messages", "packing"]),
    ("services/perception", &["dataset", "messages", "packing", "physical", "runtime"]),
    ("services/candidates", &["messages", "packing", "runtime"]),
    ("services/scorer", &["messages", "packing", "policy", "runtime"]),
    ("services/commander", &["journal", "messages", "packing", "runtime"]),
    ("tools/packcell", &["dataset", "journal", "messages", "packing", "peer", "report", "runtime"]),
    ("tools/packlab", &["dataset", "packing", "physical", "policy", "report"]),
    // Measures the services' work without the bus, so it is the one tool that holds their libraries.
    ("tools/peer", &["candidates", "commander", "journal", "messages", "packing", "policy", "runtime", "scorer"]),
    (
        "tests",
        &[
            "candidates",
            "commander",
            "dataset",
            "journal",
            "messages",
            "packing",
            "perception",
            "policy",
            "runtime",
            "scorer",
        ],
    ),
];

/// Dependencies that only one crate may name.
const ONLY_IN: [(&str, &[&str]); 4] = [
    ("burn", &["shared/policy"]),
    ("rapier3d", &["shared/physical"]),
    ("iceoryx2", &["shared/messages", "shared/runtime"]),
    ("bincode", &["shared/journal", "shared/policy", "services/perception", "tools/peer"]),
];

fn manifest(dir: &Path) -> toml::Table {
    toml::from_str(&fs::read_to_string(dir.join("Cargo.toml")).unwrap()).unwrap()
}

/// Everything a crate depends on, for building and for testing.
fn dependencies(dir: &Path) -> BTreeSet<String> {
    let manifest = manifest(dir);
    let tables = ["dependencies", "dev-dependencies", "build-dependencies"].map(|name| manifest.get(name));
    tables.into_iter().flatten().flat_map(|table| table.as_table().unwrap().keys().cloned()).collect()
}

fn members() -> BTreeSet<String> {
    let mut members: BTreeSet<String> = ["tests".to_owned()].into();
    for folder in ["shared", "services", "tools"] {
        for entry in fs::read_dir(root().join(folder)).unwrap().flatten() {
            members.insert(format!("{folder}/{}", entry.file_name().into_string().unwrap()));
        }
    }
    members
}

#[test]
fn crates_import_only_what_they_may() {
    let listed: BTreeSet<String> = MAY_IMPORT.iter().map(|(member, _)| (*member).to_owned()).collect();
    assert_eq!(members(), listed, "every crate has its line here");
    let ours: BTreeSet<&str> = MAY_IMPORT.iter().map(|(member, _)| member.rsplit('/').next().unwrap()).collect();
    for (member, allowed) in MAY_IMPORT {
        for dependency in dependencies(&root().join(member)) {
            let is_breach = ours.contains(dependency.as_str()) && !allowed.contains(&dependency.as_str());
            assert!(!is_breach, "{member} must not depend on {dependency}");
            for (foreign, homes) in ONLY_IN {
                assert!(dependency != foreign || homes.contains(&member), "{member} must not name {foreign}");
            }
        }
    }
}

#[test]
fn a_main_wires_and_fits_a_screen() {
    for member in members() {
        let main = root().join(&member).join("src/main.rs");
        let Ok(text) = fs::read_to_string(&main) else { continue };
        let lines = text.lines().filter(|line| !line.trim().is_empty()).count();
        assert!(lines <= 85, "{member}/src/main.rs has {lines} lines");
        assert!(text.starts_with("//! "), "{member}/src/main.rs says what it is");
    }
}

#[test]
fn readme_names_every_topic_and_every_crate() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let topics = fs::read_to_string(root().join("shared/messages/src/topics.rs")).unwrap();
    let names = topics.split('"').filter(|text| text.starts_with("packcell/") && !text.contains("/bell/"));
    for name in names {
        assert!(readme.contains(&format!("`{name}`")), "README does not explain the topic {name}");
    }
    for member in members() {
        let name = member.rsplit('/').next().unwrap();
        assert!(readme.contains(&format!("{name}/")), "README's code map lacks {member}");
    }
}

#[test]
fn the_top_level_is_as_agreed() {
    let allowed =
        ["Cargo.toml", "Cargo.lock", "services", "shared", "tools", "tests", "deploy", "README.md", "LICENSE"];
    for entry in fs::read_dir(root()).unwrap().flatten() {
        let name = entry.file_name().into_string().unwrap();
        assert!(
            name.starts_with('.') || name == "target" || allowed.contains(&name.as_str()),
            "{name} at the top level"
        );
    }
}

#[test]
fn no_dead_or_unexplained_exceptions() {
    for file in rust_files(&root()) {
        let text = fs::read_to_string(&file).unwrap();
        let marker = concat!("#[al", "low(");
        assert!(!text.contains(marker), "{}: use #[expect(..., reason = \"...\")]", file.display());
        let unfinished = concat!("TO", "DO");
        assert!(!text.contains(unfinished), "{}: finish it, or say it in README", file.display());
    }
}

fn rust_files(dir: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for folder in ["shared", "services", "tools", "tests"] {
        let mut open = vec![dir.join(folder)];
        while let Some(dir) = open.pop() {
            for entry in fs::read_dir(dir).unwrap().flatten() {
                let path = entry.path();
                if path.is_dir() {
                    open.push(path);
                } else if path.extension().is_some_and(|extension| extension == "rs") {
                    files.push(path);
                }
            }
        }
    }
    files
}
