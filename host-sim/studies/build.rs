//! Hashes the sources of core and simulator. A study stores this hash. Only a program with the same hash can continue
//! the study.

use std::{
    env, fs, io,
    path::{Path, PathBuf},
};

use sha2::{Digest as _, Sha256};

/// Paths of the core, the loop and the studies, and of the files with the versions of the libraries. The paths are
/// relative to this crate. All these sources influence the bits of results.
const SOURCES: [&str; 4] = ["../../src", "../loop/src", "src", "../../Cargo.toml"];

fn main() -> io::Result<()> {
    let root = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let mut hash = Sha256::new();
    for source in SOURCES {
        println!("cargo::rerun-if-changed={source}");
        let mut files = vec![];
        collect(&root.join(source), &mut files)?;
        files.sort();
        for file in files {
            let text = fs::read(&file)?;
            let name = file.strip_prefix(&root).unwrap_or(&file).to_string_lossy().into_owned();
            for part in [name.as_bytes(), &text] {
                hash.update((part.len() as u64).to_le_bytes());
                hash.update(part);
            }
        }
    }
    let hex: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    println!("cargo::rustc-env=ZWIDTH_SOURCES={hex}");
    Ok(())
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if !path.is_dir() {
        files.push(path.into());
        return Ok(());
    }
    for entry in fs::read_dir(path)? {
        collect(&entry?.path(), files)?;
    }
    Ok(())
}
