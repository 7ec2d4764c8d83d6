//! `cargo seal ELF ..`, and the runner of `cargo flash`.

use std::{
    env,
    ffi::{OsStr, OsString},
    fs,
    io::{Seek as _, SeekFrom, Write as _},
    process::{Command, ExitCode},
};

const USAGE: &str = "usage: cargo seal ELF ..
Puts the checksum of the firmware's image into each ELF, where it is. Without it a board refuses the image; what is
made of the ELF, HEX or BIN, has to be made after it.

       cargo seal --run ELF ARGUMENT ..
Does the same, then runs `probe-rs run ELF ARGUMENT ..`: what `cargo flash` does.";

/// Writes only the four bytes of the seal, so a full disk cannot cut the file.
fn seal(path: &OsStr) -> Result<(), String> {
    let named = |error: String| format!("{}: {error}", path.display());
    let mut elf = fs::read(path).map_err(|error| named(error.to_string()))?;
    let Some(place) = seal::seal(&mut elf).map_err(named)? else { return Ok(()) };
    let write = || {
        let mut file = fs::OpenOptions::new().write(true).open(path)?;
        file.seek(SeekFrom::Start(place as u64))?;
        file.write_all(&elf[place..place + 4])
    };
    write().map_err(|error: std::io::Error| named(error.to_string()))
}

/// Runs `probe-rs`. On Unix, `probe-rs` replaces this process.
fn probe_rs(arguments: &[OsString]) -> Result<ExitCode, String> {
    let mut command = Command::new("probe-rs");
    command.arg("run").args(arguments);
    #[cfg(unix)]
    let ended = Err(std::os::unix::process::CommandExt::exec(&mut command));
    #[cfg(not(unix))]
    let ended = command.status();
    let ended: std::io::Result<std::process::ExitStatus> = ended;
    let status = ended.map_err(|error| format!("probe-rs: {error}"))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(ExitCode::from(code.unwrap_or(1)))
}

fn run(arguments: &[OsString]) -> Result<ExitCode, String> {
    match arguments {
        [] => Err(USAGE.into()),
        [first] if first == "--help" || first == "-h" => {
            println!("{USAGE}");
            Ok(ExitCode::SUCCESS)
        }
        [first, rest @ ..] if first == "--run" => {
            seal(rest.first().ok_or(USAGE)?)?;
            probe_rs(rest)
        }
        elfs => {
            elfs.iter().try_for_each(|elf| seal(elf))?;
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn main() -> ExitCode {
    let arguments: Vec<OsString> = env::args_os().skip(1).collect();
    run(&arguments).unwrap_or_else(|error| {
        eprintln!("error: {error}");
        ExitCode::FAILURE
    })
}
