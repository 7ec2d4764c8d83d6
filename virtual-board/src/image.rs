//! Builds the firmware's ELF.

use std::{
    fs::File,
    path::{Path, PathBuf},
    process::Command,
};

const TARGET: &str = "thumbv7em-none-eabihf";

/// Root of the workspace that this crate was built in.
fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Builds the ELF of a board, as `cargo firmware` does but for the target directory: its own, so
/// that it never waits for a build that is waiting for it. Builds of several processes follow each
/// other. Adds the target to the tool chain if it is missing.
///
/// # Errors
/// What `cargo` or `rustup` said.
pub fn build(board: &str) -> Result<PathBuf, String> {
    build_variant(board, &[])
}

/// The same with further features of the firmware.
///
/// # Errors
/// What `cargo` or `rustup` said.
pub fn build_variant(board: &str, features: &[&str]) -> Result<PathBuf, String> {
    let name = [&[board], features].concat().join(",");
    let target_dir = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| workspace().join("target"), PathBuf::from);
    let target_dir = target_dir.join("firmware-images");
    std::fs::create_dir_all(&target_dir)
        .map_err(|error| format!("{}: {error}", target_dir.display()))?;
    let lock = target_dir.join("build.lock");
    let lock = File::create(&lock).map_err(|error| format!("{}: {error}", lock.display()))?;
    lock.lock().map_err(|error| error.to_string())?;
    add_target()?;
    let target_dir = target_dir.join(board);
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        .current_dir(workspace())
        .args([
            "build",
            "--quiet",
            "--profile",
            "firmware",
            "--package",
            "zwidth",
            "--bin",
            "zwidth",
        ])
        .args(["--target", TARGET, "--no-default-features", "--features", &name])
        .arg("--target-dir")
        .arg(&target_dir);
    run(&mut cargo)?;
    let built = target_dir.join(TARGET).join("firmware").join("zwidth");
    // Under its own name, and at one stroke: the next build, of another variant, replaces the file.
    let (draft, elf) = (target_dir.join("draft.elf"), target_dir.join(format!("{name}.elf")));
    std::fs::copy(&built, &draft)
        .and_then(|_| std::fs::rename(&draft, &elf))
        .map_err(|error| format!("{}: {error}", elf.display()))?;
    Ok(elf)
}

/// Adds the target through `rustup`, if the tool chain lacks it.
fn add_target() -> Result<(), String> {
    let sysroot =
        Command::new("rustc").current_dir(workspace()).args(["--print", "sysroot"]).output();
    let installed = sysroot.is_ok_and(|output| {
        let sysroot = PathBuf::from(String::from_utf8_lossy(&output.stdout).trim());
        sysroot.join("lib/rustlib").join(TARGET).exists()
    });
    if installed {
        return Ok(());
    }
    run(Command::new("rustup").current_dir(workspace()).args(["target", "add", TARGET]))
}

fn run(command: &mut Command) -> Result<(), String> {
    let output = command.output().map_err(|error| format!("{command:?}: {error}"))?;
    if output.status.success() {
        Ok(())
    } else {
        Err(format!("{command:?}:\n{}", String::from_utf8_lossy(&output.stderr)))
    }
}
