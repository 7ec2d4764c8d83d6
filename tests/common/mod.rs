//! Builds for the board's target out of a test.

use std::{
    env,
    fs::{self, File},
    path::PathBuf,
    process::Command,
};

/// The board's target.
pub const TARGET: &str = "thumbv7em-none-eabihf";

/// Folder for what the tests build. Not the one of the running `cargo test`, whose lock is held.
pub fn target_folder() -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("board")
}

/// Runs `cargo` with those arguments for the board's target, which is installed if it is missing.
///
/// # Panics
/// Prints what cargo or rustup said if it fails.
pub fn cargo(args: &[&str]) {
    let folder = target_folder();
    fs::create_dir_all(&folder).unwrap();
    // rustup must not run twice at once, and one build waits for the other anyway
    let lock = File::create(folder.join("lock")).unwrap();
    lock.lock().unwrap();
    install_target();
    let output = Command::new(env!("CARGO"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(args)
        .args(["--target", TARGET, "--target-dir"])
        .arg(&folder)
        .env_remove("RUSTFLAGS") // the host's flags, such as coverage, are not the board's
        .output()
        .unwrap();
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
}

fn install_target() {
    let installed =
        Command::new("rustc").args(["--print", "target-libdir", "--target", TARGET]).output();
    if let Ok(output) = installed {
        let folder = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        if output.status.success() && PathBuf::from(folder).is_dir() {
            return;
        }
    }
    let output = Command::new("rustup").args(["target", "add", TARGET]).output();
    let output = output.expect("rustup is needed to install the board's target");
    assert!(output.status.success(), "rustup: {}", String::from_utf8_lossy(&output.stderr));
}
