//! The envelope of the firmware's board, and link arguments. They stand here and not in .cargo/config.toml, because an
//! environment variable RUSTFLAGS silently replaces those and yields an image without vectors.

use std::{env, fs, path::PathBuf};

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
    let board = ["nucleo-f446re", "discovery-f407"].into_iter().find(|board| {
        let feature = board.to_uppercase().replace('-', "_");
        env::var_os(format!("CARGO_FEATURE_{feature}")).is_some()
    });
    let csv = board.map_or_else(String::new, |board| {
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
