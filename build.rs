//! Puts the device record and the commit into an image, and sets the link arguments. The link arguments are not in
//! .cargo/config.toml, because an environment variable RUSTFLAGS would silently replace them there. The image would
//! then have no vectors.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::{self, Command},
};

/// Every device record begins with these bytes. `BOARD_AT` and `BOARD_LENGTH` say where in the record the name of its
/// board is (src/device/record.rs).
const MAGIC: &[u8] = b"ZWD";
const BOARD_AT: usize = 12;
const BOARD_LENGTH: usize = 16;
/// Length of the longest record, in bytes. A record has one flash sector.
const LONGEST: usize = 16 * 1024;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    if let Some(board) = board() {
        fs::write(out.join("device.record"), record(&board)).expect("OUT_DIR is writable");
        let (commit, watched) = commit(Path::new(""));
        println!("cargo:rustc-env=ZWIDTH_COMMIT={commit}");
        for path in watched {
            println!("cargo:rerun-if-changed={}", path.display());
        }
    }
    fs::copy("memory.x", out.join("memory.x")).expect("OUT_DIR is writable");
    println!("cargo:rustc-link-search={}", out.display());
    // If DEFMT_LOG is not set, defmt drops every line below `error`. So the default here is `info`.
    println!("cargo:rerun-if-env-changed=DEFMT_LOG");
    let level = env::var("DEFMT_LOG").unwrap_or_else(|_| "info".into());
    println!("cargo:rustc-env=DEFMT_LOG={level}");
    for argument in ["-Tlink.x", "-Tdefmt.x", "--nmagic"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
}

/// The first device record of the image: the file that ZWIDTH_DEVICE names, or the record of the board's own scene. The
/// firmware checks at boot whether the record is complete. This script cannot check the record, because a build script
/// cannot use the package's own code.
fn record(board: &str) -> Vec<u8> {
    println!("cargo:rerun-if-env-changed=ZWIDTH_DEVICE");
    let given = env::var_os("ZWIDTH_DEVICE").filter(|path| !path.is_empty());
    let path = given.map_or_else(|| format!("scenes/{board}.device").into(), PathBuf::from);
    println!("cargo:rerun-if-changed={}", path.display());
    let bytes = fs::read(&path).unwrap_or_else(|error| refuse(&path, &error.to_string()));
    let name = bytes.get(BOARD_AT..BOARD_AT + BOARD_LENGTH).unwrap_or_default();
    let name = String::from_utf8_lossy(name);
    let name = name.trim_end_matches('\0');
    if !bytes.starts_with(MAGIC) || bytes.len() > LONGEST {
        refuse(&path, "is no device record, cargo sim prepare makes one");
    }
    if name != board {
        refuse(&path, &format!("is the record of a device on {name}, this image is for {board}"));
    }
    bytes
}

/// Files of the package from which an image is built. The device record has a hash of its own.
const SOURCES: [&str; 7] =
    [".cargo", "Cargo.lock", "Cargo.toml", "build.rs", "memory.x", "rust-toolchain.toml", "src"];

/// The commit of the package in `folder`, and the files that cargo watches for a change. The commit has 12 digits, and
/// ends in `-dirty` if a source of the image is not as committed. In a source archive without git the commit is
/// `unknown`, even if the archive is unpacked inside another repository. No code of the host depends on the commit. So
/// a new commit rebuilds only the image.
pub fn commit(folder: &Path) -> (String, Vec<PathBuf>) {
    let git = |words: &[&str]| {
        let mut git = Command::new("git");
        if folder != Path::new("") {
            git.current_dir(folder);
        }
        let told = git.arg("--no-optional-locks").args(words).output().ok()?;
        let text = String::from_utf8(told.stdout).ok()?;
        told.status.success().then(|| text.trim_end().to_owned())
    };
    let unknown = || ("unknown".into(), SOURCES.iter().map(|path| folder.join(path)).collect());
    // The prefix is empty if the package is the top folder of the repository.
    if git(&["rev-parse", "--show-prefix"]).is_none_or(|prefix| !prefix.is_empty()) {
        return unknown();
    }
    let status = [&["status", "--porcelain", "--untracked-files=all", "--"], &SOURCES[..]].concat();
    let (Some(hash), Some(changed)) = (git(&["rev-parse", "--short=12", "HEAD"]), git(&status))
    else {
        return unknown();
    };
    let branch = git(&["symbolic-ref", "--quiet", "HEAD"]);
    let of_git = ["HEAD", "logs/HEAD", "packed-refs"].into_iter().chain(branch.as_deref());
    let watched = of_git
        .filter_map(|name| git(&["rev-parse", "--git-path", name]))
        .chain(SOURCES.map(String::from))
        .map(|path| folder.join(path))
        .filter(|path| path.exists())
        .collect();
    (format!("{hash}{}", if changed.is_empty() { "" } else { "-dirty" }), watched)
}

fn refuse(path: &Path, why: &str) -> ! {
    println!("cargo::error=ZWIDTH_DEVICE: {} {why}", path.display());
    process::exit(1);
}

/// The board that the Cargo features select. The feature has the name of the board's file in `src/board`. Without such
/// a feature only the library is built, and the result is `None`.
fn board() -> Option<String> {
    println!("cargo:rerun-if-changed=src/board");
    let files = fs::read_dir("src/board").expect("the package has src/board");
    let mut names: Vec<String> = files
        .filter_map(|file| file.ok()?.file_name().to_str()?.strip_suffix(".rs").map(String::from))
        .filter(|name| name != "mod")
        .collect();
    names.sort();
    let is_on =
        |name: &&String| env::var_os(format!("CARGO_FEATURE_{}", name.to_uppercase())).is_some();
    let on: Vec<&String> = names.iter().filter(is_on).collect();
    if on.len() > 1 {
        let all = names.join(" or ").replace('_', "-");
        println!("cargo::error=pick one board: --no-default-features --features {all}");
        process::exit(1);
    }
    on.first().map(|name| name.replace('_', "-"))
}
