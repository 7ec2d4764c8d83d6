//! Start and end of every command: its arguments, signals, output and errors.

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
    output::{SCHEMA_VERSION, files, signals},
};

/// Messages of the standard library for a word that is not a number. A clearer message stands beside each, and replaces
/// it.
const NUMBERS: [(&str, &str); 2] = [
    ("invalid float literal", "it has to be a number, without a unit"),
    ("invalid digit found in string", "it has to be a whole number, without a unit"),
];

/// Whether result and error are printed as JSON, and the name of the command. The name is `None` if the command does
/// not exist.
static JSON: OnceLock<(bool, Option<String>)> = OnceLock::new();
/// Whether an error has been printed. Only the first error is printed.
static SAID: AtomicBool = AtomicBool::new(false);

/// The JSON object that a command prints, with its head and its content.
#[derive(Serialize)]
struct Headed<'a, T: Serialize> {
    schema_version: u32,
    command: Option<&'a str>,
    #[serde(flatten)]
    body: T,
}

/// An error as JSON for programs. This object is printed on stdout in place of the result.
#[derive(Serialize)]
struct Failed<'a> {
    error: JsonError<'a>,
}

#[derive(Serialize)]
struct JsonError<'a> {
    kind: &'a str,
    message: &'a str,
    exit_code: u8,
}

/// Runs a command line, and listens to signals. If there is an error, it is printed. Returns the exit code: 0 is done,
/// 1 is failed, 2 is invalid input, 130 is interrupted.
pub fn run<T: Parser>(execute: impl FnOnce(T) -> Result<(), Error>) -> u8 {
    let cli = match parse() {
        Ok(cli) => cli,
        Err(exit_code) => return exit_code,
    };
    let watched = signals::watch(files::abandon, || say_error(&Error::Interrupted));
    let Err(error) = watched.and_then(|()| execute(cli)) else { return 0 };
    let error = if interrupt::is_requested() { Error::Interrupted } else { error };
    say_error(&error);
    error.exit_code()
}

/// The parsed command line, or the exit code if help, version or an error was printed instead.
fn parse<T: Parser>() -> Result<T, u8> {
    let matches = T::command().try_get_matches();
    let cli = matches.and_then(|mut matches| {
        let command = matches.subcommand().map(|(name, options)| {
            let json = options.try_get_one("json").ok().flatten().is_some_and(|json| *json);
            (json, Some(name.to_owned()))
        });
        let _ = JSON.set(command.unwrap_or_default());
        T::from_arg_matches_mut(&mut matches)
    });
    cli.map_err(|error| {
        let is_help = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
        if is_help || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
            let _ = error.print(); // a closed pipe must not cause a panic
            return u8::from(error.use_stderr()) * 2;
        }
        let text = error.to_string();
        let ends = |line: &&str| line.starts_with("Usage:") || line.starts_with("For more");
        let lines = text.lines().map(str::trim).take_while(|line| !ends(line));
        let lines: Vec<&str> = lines.filter(|line| !line.is_empty()).collect();
        let line =
            NUMBERS.iter().fold(lines.join(" "), |line, (of_std, said)| line.replace(of_std, said));
        let line = line.strip_prefix("error: ").unwrap_or(&line);
        let args: Vec<_> = std::env::args_os().skip(1).take_while(|arg| arg != "--").collect();
        let command = T::command();
        let named = args.iter().find_map(|arg| command.find_subcommand(arg));
        let json = args.iter().any(|arg| arg == "--json");
        let _ = JSON.set((json, named.map(|command| command.get_name().to_owned())));
        say_error(&Error::Input(format!("{line} (see --help)")));
        2
    })
}

/// Prints one line on stderr, and with `--json` an object on stdout. If both fail, only the exit code shows the error.
fn say_error(error: &Error) {
    if SAID.swap(true, Ordering::Relaxed) {
        return;
    }
    let message = &one_line(&error.to_string());
    let _ = writeln!(io::stderr(), "error: {message}");
    if JSON.get().is_some_and(|(json, _)| *json) {
        let (kind, exit_code) = (error.kind(), error.exit_code());
        let _ = print_json(Failed { error: JsonError { kind, message, exit_code } });
    }
}

/// `body` as JSON, after the head that every object has: schema version and command.
pub fn headed(body: impl Serialize) -> Result<String, Error> {
    let command = JSON.get().and_then(|(_, command)| command.as_deref());
    let headed = Headed { schema_version: SCHEMA_VERSION, command, body };
    serde_json::to_string_pretty(&headed)
        .map_err(|error| Error::Internal(format!("cannot write JSON: {error}")))
}

pub fn print_json(body: impl Serialize) -> Result<(), Error> {
    print_text(&headed(body)?)
}

/// Prints the result of a command: with `--json` one object, otherwise the text.
pub fn print_result(
    json: bool,
    body: impl Serialize,
    text: impl FnOnce() -> String,
) -> Result<(), Error> {
    if json { print_json(body) } else { print_text(&text()) }
}

/// Prints lines. A closed pipe is not an error.
pub fn print_text(text: &str) -> Result<(), Error> {
    let mut stdout = io::stdout();
    let printed = writeln!(stdout, "{}", printable(text, true)).and_then(|()| stdout.flush());
    match printed {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.map_err(Error::file("stdout")),
    }
}

pub fn note(text: &str) {
    let _ = writeln!(io::stderr(), "{}", printable(text, true));
}
