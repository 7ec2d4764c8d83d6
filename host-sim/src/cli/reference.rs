//! `reference`: lists of the firmware's own tables, as Markdown for the book.

use clap::{Args, ValueEnum};
use zwidth::{console, ends, safety::Fault, velocity::EstimatorName};

use crate::{error::Error, output::terminal::print_text, scene::NamedScene};

/// Prints a list of the firmware's own tables as Markdown, as the book shows it.
#[derive(Debug, Args)]
pub struct ReferenceArgs {
    list: List,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum List {
    /// How each command of the console is typed.
    Console,
    /// Velocity estimators: number, name, parameters with units, defaults and ranges, and what they need.
    Estimators,
    /// Codes and names of the faults.
    Faults,
}

pub fn run(args: &ReferenceArgs) -> Result<(), Error> {
    let text = match args.list {
        List::Console => {
            table(&["command"], console::usages().map(|usage| vec![format!("`{usage}`")]))
        }
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
    };
    print_text(&text)
}

fn table(head: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let line = |cells: &[String]| format!("| {} |", cells.join(" | "));
    let head: Vec<String> = head.iter().map(|&cell| cell.to_owned()).collect();
    let rule = vec!["---".to_owned(); head.len()];
    [head, rule].into_iter().chain(rows).map(|cells| line(&cells)).collect::<Vec<_>>().join("\n")
}

/// A row for each parameter. A value that no parameter takes is refused with the range that it takes.
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
