//! The comparison for a terminal: several small tables. No line is wider than [`WIDTH`].

use super::{
    Compared, Place,
    table::{self, CRITERIA, Parameter, Part},
    winners::{Winner, sentence},
};
use crate::{notation::number, scene::Units};

/// Largest line width, in characters.
pub const WIDTH: usize = 120;

/// The comparison as text: the tables, the winners and the notes.
pub fn text(compared: &[Compared], place: &Place, winners: &[Winner], units: Units) -> String {
    let mut text = String::new();
    tunings(&mut text, compared);
    for part in Part::ALL {
        let criteria: Vec<_> = CRITERIA.iter().filter(|criterion| criterion.part == part).collect();
        let heads = criteria.iter().map(|criterion| [criterion.name, criterion.unit(units)]);
        let rows = compared.iter().map(|c| {
            let cells = criteria.iter().map(|criterion| criterion.cell(c, place, units)).collect();
            (c.entry.name(), cells)
        });
        table(&mut text, part.title(), &heads.collect::<Vec<_>>(), &rows.collect::<Vec<_>>());
    }
    text.push_str("Best by each criterion\n");
    for winner in winners {
        wrapped(&mut text, &sentence(winner));
    }
    text.push_str("\nNotes\n");
    for note in table::notes(compared, place, units) {
        wrapped(&mut text, &note);
    }
    text
}

/// The text of a parameter with its unit. A star marks a value that is at an end of its range.
pub fn parameter(parameter: Option<Parameter>) -> String {
    match parameter {
        None => String::new(),
        Some(Parameter { value, unit, edge, .. }) => {
            let digits = if unit == "samples" {
                0
            } else if value.abs() < 10.0 {
                3
            } else {
                1
            };
            let unit = if unit == "1" { String::new() } else { format!(" {unit}") };
            let star = if edge.is_some() { "*" } else { "" };
            format!("{}{unit}{star}", number(value, digits))
        }
    }
}

fn tunings(text: &mut String, compared: &[Compared]) {
    let heads =
        [["needs", ""], ["tuning", ""], ["second parameter", ""], ["walks", ""], ["hits", ""]];
    let rows = compared.iter().map(|c| {
        let [tuning, second] = table::parameters(c);
        let second = match second {
            None => String::new(),
            Some(p) => format!("{} {}", p.name, parameter(second)),
        };
        let walks = format!("{}{}", table::search_walks(c), if c.tuned.settled { "" } else { "+" });
        let hits = c.tuned.hits.to_string();
        (c.entry.name(), vec![c.needs().to_owned(), parameter(tuning), second, walks, hits])
    });
    table(
        text,
        "Tunings (*: an end of the range; +: the search did not settle)",
        &heads,
        &rows.collect::<Vec<_>>(),
    );
}

/// A table with columns as wide as their content.
fn table(text: &mut String, title: &str, heads: &[[&str; 2]], rows: &[(String, Vec<String>)]) {
    let width = |cell: &str| cell.chars().count();
    let first = rows.iter().map(|(name, _)| width(name)).max().unwrap_or(0);
    let widths: Vec<usize> = heads
        .iter()
        .enumerate()
        .map(|(n, head)| {
            let cells = rows.iter().filter_map(|(_, cells)| cells.get(n)).map(|cell| width(cell));
            cells.chain(head.iter().map(|line| width(line))).max().unwrap_or(0)
        })
        .collect();
    let mut line = |name: &str, cells: &mut dyn Iterator<Item = &str>| {
        let mut line = format!("{name:<first$}");
        for (cell, width) in cells.zip(&widths) {
            line.push_str(&format!("  {cell:>width$}"));
        }
        text.push_str(line.trim_end());
        text.push('\n');
    };
    line(title, &mut std::iter::empty());
    for n in 0..2 {
        if heads.iter().any(|head| !head[n].is_empty()) {
            line("", &mut heads.iter().map(|head| head[n]));
        }
    }
    for (name, cells) in rows {
        line(name, &mut cells.iter().map(String::as_str));
    }
    text.push('\n');
}

/// Adds a sentence with line breaks. The lines after the first one are indented.
fn wrapped(text: &mut String, sentence: &str) {
    let mut column = 0;
    for word in sentence.split(' ') {
        let length = word.chars().count();
        if column > 0 && column + 1 + length > WIDTH {
            text.push_str("\n  ");
            column = 2;
        } else if column > 0 {
            text.push(' ');
            column += 1;
        }
        text.push_str(word);
        column += length;
    }
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_sentences_are_wrapped_between_words() {
        let mut text = String::new();
        wrapped(&mut text, &"word ".repeat(60));
        assert!(
            text.lines().count() == 3 && text.lines().all(|line| line.len() <= WIDTH),
            "{text}"
        );
        assert_eq!(text.split_whitespace().count(), 60);
    }
}
