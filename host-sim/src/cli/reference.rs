//! `reference`: prints the firmware's tables as Markdown for the book.

use clap::{Args, Command, ValueEnum};
use zwidth::{console, ends, safety::Fault, velocity::EstimatorName};

use crate::{
    error::Error,
    output::terminal::print_text,
    scene::{NamedScene, schema},
};

/// Prints a table of the firmware as Markdown, as the book has it.
#[derive(Debug, Args)]
pub struct ReferenceArgs {
    list: List,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum List {
    /// Commands of `cargo sim` with their options.
    Commands,
    /// Syntax of each console command.
    Console,
    /// Velocity estimators: number, name, parameters with units, defaults and ranges, and needed inputs.
    Estimators,
    /// Codes and names of the faults.
    Faults,
    /// Keys of scene files: meaning, unit, and allowed values.
    Scene,
}

pub fn run(args: &ReferenceArgs, program: &Command) -> Result<(), Error> {
    let text = match args.list {
        List::Commands => commands(program),
        List::Console => table(
            &["command"],
            console::usages().map(|usage| vec![format!("`{}`", usage.replace('|', "\\|"))]),
        ),
        List::Estimators => {
            let head = [
                "number",
                "estimator",
                "parameter",
                "unit",
                "default",
                "accepted at 1 um and 10 kHz",
                "needs",
            ];
            let design = NamedScene::load("paper-1um")?.scene.design();
            let rows = EstimatorName::ALL.iter().flat_map(|&name| estimator(name, &design));
            table(&head, rows)
        }
        List::Faults => {
            let row = |fault: &Fault| vec![fault.code().to_string(), fault.text().to_owned()];
            table(&["code", "fault"], Fault::ALL.iter().map(row))
        }
        List::Scene => {
            let rows = schema::keys().into_iter().map(|key| {
                let name = format!("`{}`", key.path);
                vec![name, key.unit.unwrap_or_default(), key.meaning, key.allowed, key.absent]
            });
            table(&["key", "unit", "meaning", "allowed", "absent"], rows)
        }
    };
    print_text(&text)
}

fn table(head: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let line = |cells: &[String]| format!("| {} |", cells.join(" | "));
    let head: Vec<String> = head.iter().map(|&cell| cell.to_owned()).collect();
    let rule = vec!["---".to_owned(); head.len()];
    [head, rule].into_iter().chain(rows).map(|cells| line(&cells)).collect::<Vec<_>>().join("\n")
}

/// Tables of options: first the options of all commands, then one table for each command.
fn commands(program: &Command) -> String {
    let mut sections = vec![];
    let rows = |command: &Command, of_all: bool| {
        let options = command.get_arguments().filter(|option| option.is_global_set() == of_all);
        let rows = options.filter(|option| !option.is_hide_set()).map(|option| {
            let name = option.get_long().map_or(String::new(), |long| format!("--{long}"));
            let takes = option.get_action().takes_values() || option.is_positional();
            let values = option.get_value_names().unwrap_or_default().join(" ");
            let form = format!("{name} {}", if takes { &values } else { "" });
            let default = option.get_default_values().first().filter(|_| takes);
            let default =
                default.map_or(String::new(), |value| value.to_string_lossy().into_owned());
            let choices: Vec<_> = option.get_possible_values();
            let choices: Vec<_> = choices.iter().map(|value| value.get_name().to_owned()).collect();
            let allowed = if takes { choices.join(", ") } else { String::new() };
            let help = option.get_help().map(ToString::to_string).unwrap_or_default();
            vec![
                format!("`{}`", form.trim()),
                help.replace('\n', " ").replace('|', "\\|"),
                allowed,
                default,
            ]
        });
        table(&["option", "meaning", "allowed", "default"], rows)
    };
    sections.push(format!("### Options of every command\n\n{}", rows(program, true)));
    for command in program.get_subcommands().filter(|command| command.get_name() != "help") {
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        let name = command.get_name();
        sections.push(format!("### `cargo sim {name}`\n\n{about}\n\n{}", rows(command, false)));
    }
    sections.join("\n\n")
}

/// A row for each parameter of an estimator. The range is read from the error for a value out of range.
fn estimator(name: EstimatorName, design: &zwidth::Design) -> Vec<Vec<String>> {
    let defaults = name.parameters().map(|p| p.map_or(0.0, |parameter| parameter.default));
    let start = [name.id().to_string(), format!("`{}`", name.text())];
    let needs = name.sense().map_or("", |sense| sense.text()).to_owned();
    let parameters = name.parameters().into_iter().flatten().zip(name.keys()).enumerate();
    let rows: Vec<_> = parameters
        .map(|(place, (parameter, key))| {
            let mut refused = defaults;
            refused[place] = f64::NAN;
            let range = name.settings(refused).build(design).map_or_else(
                |error| {
                    let [low, high] = ends(&error.range);
                    format!("{low} to {high}")
                },
                |_| "any".to_owned(),
            );
            let cells =
                [format!("`{key}`"), parameter.unit.to_owned(), parameter.default.to_string()];
            [&start[..], &cells, &[range, needs.clone()]].concat()
        })
        .collect();
    if rows.is_empty() {
        let none = [const { String::new() }; 4];
        return vec![[&start[..], &none, &[needs]].concat()];
    }
    rows
}
