//! How every command line begins and ends: arguments, signals, what it prints, errors.

use std::{
    io::{self, Write as _},
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

use clap::{Parser, error::ErrorKind};
use serde::Serialize;

use crate::{
    error::{Error, one_line, printable},
    interrupt,
    output::{SCHEMA_VERSION, files},
};

/// The command, if its result and its error are to be JSON.
static JSON: OnceLock<&'static str> = OnceLock::new();
/// One error is enough.
static SAID: AtomicBool = AtomicBool::new(false);

/// An error for a program, on stdout in place of the result.
#[derive(Serialize)]
struct Json<'a> {
    schema_version: u32,
    /// `null` if there is no such command.
    command: Option<&'a str>,
    error: JsonError<'a>,
}

#[derive(Serialize)]
struct JsonError<'a> {
    kind: &'a str,
    message: &'a str,
    exit_code: u8,
}

/// The command line.
///
/// # Errors
/// The exit code; help, version or what is wrong has been said.
pub fn parse<T: Parser>() -> Result<T, u8> {
    T::try_parse().map_err(|error| {
        let is_help = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
        if is_help || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
            let _ = error.print(); // a closed pipe is no reason to panic
            return u8::from(error.use_stderr()) * 2;
        }
        let text = error.to_string();
        let ends = |line: &&str| line.starts_with("Usage:") || line.starts_with("For more");
        let lines = text.lines().map(str::trim).take_while(|line| !ends(line));
        let lines: Vec<&str> = lines.filter(|line| !line.is_empty()).collect();
        let line = lines.join(" ");
        let line = line.strip_prefix("error: ").unwrap_or(&line);
        let args: Vec<_> = std::env::args_os().skip(1).take_while(|arg| arg != "--").collect();
        let command = T::command();
        let named = args.iter().find_map(|arg| command.find_subcommand(arg));
        let json = args.iter().any(|arg| arg == "--json");
        let json = json.then_some(named.map(clap::Command::get_name));
        say("input", &one_line(&format!("{line} (see --help)")), 2, json);
        2
    })
}

/// Listens to signals from now on; `json` is the command's name if its error is to be JSON.
///
/// # Errors
/// The system refuses.
pub fn begin(json: Option<&'static str>) -> Result<(), Error> {
    if let Some(command) = json {
        let _ = JSON.set(command);
    }
    interrupt::watch(files::abandon, || say_error(&Error::Interrupted))
}

/// Says what went wrong, if anything did, and returns the exit code: 0 done, 1 failed, 2 bad input, 130 interrupted.
pub fn end(result: Result<(), Error>) -> u8 {
    let Err(error) = result else { return 0 };
    let error = if interrupt::is_requested() { Error::Interrupted } else { error };
    say_error(&error);
    error.exit_code()
}

fn say_error(error: &Error) {
    let json = JSON.get().map(|command| Some(*command));
    say(error.kind(), &one_line(&error.to_string()), error.exit_code(), json);
}

/// One line on stderr, and the object for a program on stdout. Where nobody can be told, the exit code says it.
fn say(kind: &str, message: &str, exit_code: u8, json: Option<Option<&str>>) {
    if SAID.swap(true, Ordering::Relaxed) {
        return;
    }
    let _ = writeln!(io::stderr(), "error: {message}");
    if let Some(command) = json {
        let error = JsonError { kind, message, exit_code };
        let _ = print_json(&Json { schema_version: SCHEMA_VERSION, command, error });
    }
}

/// Prints `value` as the one JSON object of this command.
///
/// # Errors
/// [`Error::File`] if stdout cannot be written.
pub fn print_json(value: &impl Serialize) -> Result<(), Error> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|error| Error::Internal(format!("cannot write JSON: {error}")))?;
    print_text(&text)
}

/// Prints lines; a reader that hangs up is not an error of ours.
///
/// # Errors
/// [`Error::File`] if stdout cannot be written.
pub fn print_text(text: &str) -> Result<(), Error> {
    let mut stdout = io::stdout();
    let printed = writeln!(stdout, "{}", printable(text, true)).and_then(|()| stdout.flush());
    match printed {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.map_err(Error::file("stdout")),
    }
}

/// A remark on stderr.
pub fn note(text: &str) {
    let _ = writeln!(io::stderr(), "{}", printable(text, true));
}
