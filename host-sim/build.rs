//! Tells the program what it was built from: version, commit, toolchain, target.

use std::{env, process::Command};

fn main() {
    let commit = git(&["rev-parse", "HEAD"]).unwrap_or_else(|| "unknown".into());
    let dirty = match git(&["status", "--porcelain", "--untracked-files=no"]) {
        Some(changes) => (!changes.is_empty()).to_string(),
        None => "unknown".into(),
    };
    println!("cargo::rustc-env=ZWIDTH_COMMIT={commit}");
    println!("cargo::rustc-env=ZWIDTH_DIRTY={dirty}");
    println!("cargo::rustc-env=ZWIDTH_TARGET={}", env::var("TARGET").unwrap_or_default());
    let rustc = env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let toolchain = run(&rustc, &["--version"]).unwrap_or_else(|| "unknown".into());
    println!("cargo::rustc-env=ZWIDTH_TOOLCHAIN={toolchain}");
    for path in ["../src", "../scenes", "../Cargo.lock", "src", "build.rs", "Cargo.toml"] {
        println!("cargo::rerun-if-changed={path}");
    }
    if let Some(git_dir) = git(&["rev-parse", "--absolute-git-dir"]) {
        for file in ["HEAD", "index", "logs/HEAD"] {
            if std::path::Path::new(&git_dir).join(file).exists() {
                println!("cargo::rerun-if-changed={git_dir}/{file}");
            }
        }
    }
}

fn git(args: &[&str]) -> Option<String> {
    run("git", args)
}

fn run(program: &str, args: &[&str]) -> Option<String> {
    let output = Command::new(program).args(args).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
