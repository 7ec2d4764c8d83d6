//! The envelope of the firmware's board, and link arguments. They stand here and not in .cargo/config.toml, because an
//! environment variable RUSTFLAGS silently replaces those and yields an image without vectors.

use std::{env, fs, path::PathBuf, process};

#[path = "src/safety/envelope/generate.rs"]
mod generate;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=src/safety/envelope/generate.rs");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    // The walls that are predicted to be stable on this board, from `cargo sim sweep BOARD`.
    let csv = board().map_or_else(String::new, |board| {
        let path = format!("scenes/{board}.envelope.csv");
        println!("cargo:rerun-if-changed={path}");
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
    });
    let table = generate::generate("ENVELOPE", &csv).unwrap_or_else(|error| panic!("{error}"));
    fs::write(out.join("envelope.rs"), table).expect("OUT_DIR is writable");
    fs::copy("memory.x", out.join("memory.x")).expect("OUT_DIR is writable");
    println!("cargo:rustc-link-search={}", out.display());
    // Without this defmt drops every line below `error`.
    println!("cargo:rerun-if-env-changed=DEFMT_LOG");
    let level = env::var("DEFMT_LOG").unwrap_or_else(|_| "info".into());
    println!("cargo:rustc-env=DEFMT_LOG={level}");
    for argument in ["-Tlink.x", "-Tdefmt.x", "--nmagic"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
}

/// The board whose feature is on: its file in `src/board` has the same name. None for the library alone.
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
