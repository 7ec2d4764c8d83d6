//! Builds the firmware's ELF for a board's target and writes its checksum.

use std::{
    fs::File,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
    time::Duration,
};

use host_sim::interrupt;

const TARGET: &str = "thumbv7em-none-eabihf";
/// The environment variable with the path of the record that build.rs puts into the image.
const DEVICE: &str = "ZWIDTH_DEVICE";

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Builds the ELF of a board as `cargo firmware` does. The build has a separate target directory, so it does not wait
/// for the `cargo` command that runs this code. Several processes build one after another. Adds the target to the tool
/// chain if it is missing. Removes `RUSTFLAGS`, since these flags are for the host.
///
/// # Errors
/// The error of `cargo` or `rustup`.
pub fn build(board: &str) -> Result<PathBuf, String> {
    build_variant(board, &[])
}

/// Builds an image as [`build`] does, with additional features of the firmware.
pub fn build_variant(board: &str, features: &[&str]) -> Result<PathBuf, String> {
    let name = [&[board], features].concat().join(",");
    let bin = ["--bin", "zwidth", "--no-default-features", "--features", &name];
    in_turn(|folder| {
        let built = package(folder, "zwidth", &bin)?.join("zwidth");
        keep_sealed(folder, &built, &format!("{name}.elf"))
    })
}

/// Builds a board's image with this device record in it, as `ZWIDTH_DEVICE=FILE cargo firmware` does.
///
/// # Errors
/// The error of `cargo`, for example that the record is for another board.
pub fn build_with_record(board: &str, record: &Path) -> Result<PathBuf, String> {
    in_turn(|folder| {
        let bin = ["--bin", "zwidth", "--no-default-features", "--features", board];
        let mut cargo = cargo(folder, "zwidth", &bin);
        // build.rs would read a relative path from the workspace's root
        let record = record.canonicalize();
        let record = record.map_err(|error| format!("the device record: {error}"))?;
        let told = cargo.env(DEVICE, record).output().map_err(|error| error.to_string())?;
        if !told.status.success() {
            return Err(String::from_utf8_lossy(&told.stderr).into_owned());
        }
        keep_sealed(folder, &built(folder).join("zwidth"), &format!("{board},its record.elf"))
    })
}

/// Builds an archive or a program of the package `on-target` with the firmware's build options. With the result, tests
/// check the compiled code of the core.
///
/// # Errors
/// The error of `cargo` or `rustup`.
pub fn build_on_target(file: &str, features: &[&str]) -> Result<PathBuf, String> {
    let features = features.join(",");
    let part = if file.ends_with(".a") { &["--lib"][..] } else { &["--bin", file] };
    let arguments = [part, &["--features", &features]].concat();
    in_turn(|folder| {
        let built = package(folder, "on-target", &arguments)?.join(file);
        keep(folder, &built, &format!("{features}{file}"))
    })
}

/// Copies an image as [`keep`] does, and puts the checksum into the copy.
fn keep_sealed(folder: &Path, built: &Path, name: &str) -> Result<PathBuf, String> {
    let mut elf = std::fs::read(built).map_err(|error| format!("{}: {error}", built.display()))?;
    seal::seal(&mut elf).map_err(|error| format!("{}: {error}", built.display()))?;
    let sealed = folder.join("sealed");
    std::fs::write(&sealed, elf).map_err(|error| format!("{}: {error}", sealed.display()))?;
    keep(folder, &sealed, name)
}

/// Copies a built file to a name of its own, because the next build of another variant replaces the original. The copy
/// appears under this name only when it is complete.
fn keep(folder: &Path, built: &Path, name: &str) -> Result<PathBuf, String> {
    let (draft, kept) = (folder.join("draft"), folder.join(name));
    std::fs::copy(built, &draft)
        .and_then(|_| std::fs::rename(&draft, &kept))
        .map_err(|error| format!("{}: {error}", kept.display()))?;
    Ok(kept)
}

/// Runs a build in the folder of the images, while no other process builds there.
fn in_turn<T>(build: impl FnOnce(&Path) -> Result<T, String>) -> Result<T, String> {
    let folder = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| workspace().join("target"), PathBuf::from)
        .join("firmware-images");
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let lock = folder.join("build.lock");
    let lock = File::create(&lock).map_err(|error| format!("{}: {error}", lock.display()))?;
    lock.lock().map_err(|error| error.to_string())?;
    add_target()?;
    build(&folder)
}

fn package(folder: &Path, name: &str, arguments: &[&str]) -> Result<PathBuf, String> {
    run(&mut cargo(folder, name, arguments))?;
    Ok(built(folder))
}

fn built(folder: &Path) -> PathBuf {
    folder.join(TARGET).join("firmware")
}

fn cargo(folder: &Path, name: &str, arguments: &[&str]) -> Command {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        .current_dir(workspace())
        .env_remove("RUSTFLAGS")
        .env_remove(DEVICE) // without it, the board's own device is built in
        .env_remove("CARGO_INCREMENTAL") // incremental builds optimise each part alone, which changes the cycles
        .args(["build", "--quiet", "--profile", "firmware", "--target", TARGET])
        .args(["--package", name])
        .args(arguments)
        .arg("--target-dir")
        .arg(folder);
    cargo
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
    let shown = format!("{command:?}");
    let failed = |error| format!("{shown}: {error}");
    // The tool's messages go to our stderr.
    let mut child = command.stdout(Stdio::null()).spawn().map_err(failed)?;
    let status = loop {
        if interrupt::is_requested() {
            let _ = child.kill(); // the process may have ended already
            return Err("interrupted".into());
        }
        match child.try_wait().map_err(failed)? {
            Some(status) => break status,
            None => thread::sleep(Duration::from_millis(10)),
        }
    };
    if status.success() { Ok(()) } else { Err(format!("{shown}: {status}, see above")) }
}
