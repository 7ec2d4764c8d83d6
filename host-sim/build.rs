//! Tells the program what it was built from: version, commit, toolchain, target.
//!
//! Only a release build, as `cargo sim` makes, has the commit. A debug build, as for tests, has none. Otherwise it
//! would be built again after every commit and every change of the firmware.

use std::{env, process::Command};

fn main() {
    let release = env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let [commit, dirty] =
        if release { built_from() } else { ["debug build", "unknown"].map(Into::into) };
    println!("cargo::rustc-env=ZWIDTH_COMMIT={commit}");
    println!("cargo::rustc-env=ZWIDTH_DIRTY={dirty}");
    println!("cargo::rustc-env=ZWIDTH_TARGET={}", env::var("TARGET").unwrap_or_default());
    let rustc = env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let toolchain = run(&rustc, &["--version"]).unwrap_or_else(|| "unknown".into());
    println!("cargo::rustc-env=ZWIDTH_TOOLCHAIN={toolchain}");
    println!("cargo::rerun-if-changed=build.rs");
}

/// Commit, and whether tracked files differ from it.
fn built_from() -> [String; 2] {
    for path in [
        "../src",
        "../lab/filter-forms",
        "../lab/trade",
        "../scenes",
        "../Cargo.lock",
        "src",
        "studies",
        "loop",
        "bitmap",
        "Cargo.toml",
    ] {
        println!("cargo::rerun-if-changed={path}");
    }
    if let Some(git_dir) = git(&["rev-parse", "--absolute-git-dir"]) {
        for file in ["HEAD", "logs/HEAD"] {
            if std::path::Path::new(&git_dir).join(file).exists() {
                println!("cargo::rerun-if-changed={git_dir}/{file}");
            }
        }
    }
    let commit = git(&["rev-parse", "HEAD"]).unwrap_or_else(|| "unknown".into());
    // Without `--no-optional-locks` git would write the index of a fresh clone.
    let dirty = match git(&["--no-optional-locks", "status", "--porcelain", "--untracked-files=no"])
    {
        Some(changes) => (!changes.is_empty()).to_string(),
        None => "unknown".into(),
    };
    [commit, dirty]
}

fn git(args: &[&str]) -> Option<String> {
    run("git", args)
}

fn run(program: &str, args: &[&str]) -> Option<String> {
    let output = Command::new(program).args(args).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
