//! Reads numbers from the named columns of a user's table. docs/files.md describes the format.

use std::{iter, ops::RangeInclusive};

use csv_core::{ReadRecordResult, Reader, ReaderBuilder};
use zwidth::ends;

pub const FINITE: RangeInclusive<f64> = f64::MIN..=f64::MAX;
/// Any finite number from 0 on.
pub const FROM_0: RangeInclusive<f64> = 0.0..=f64::MAX;

/// Characters that may separate two cells.
const DELIMITERS: [char; 3] = [',', ';', '\t'];
const ROWS_MAX: usize = 8_000_000;
/// Length of the longest line that a table may have, in bytes.
const LINE_MAX: usize = 1 << 20;
/// Number of characters of a cell that a message shows.
const SHOWN: usize = 30;

/// A column's name, and the range of its numbers.
pub type Column<'a> = (&'a str, RangeInclusive<f64>);

/// The text of a table with a header.
#[derive(Clone, Debug)]
pub struct Table<'a> {
    text: &'a str,
    delimiter: char,
    line: usize,
    header: Vec<String>,
}

impl<'a> Table<'a> {
    /// Finds the header of a table.
    ///
    /// # Errors
    /// One line: the text has no header, or a quote in the header does not end.
    pub fn new(text: &'a str) -> Result<Self, String> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let first = lines(text).next().ok_or("the file is empty")?;
        let tables = DELIMITERS.map(|delimiter| {
            let header =
                Splitter::new(delimiter).cells(first)?.into_iter().map(str::to_owned).collect();
            Ok(Self { text, delimiter, line: first.1, header })
        });
        let named = |table: &Self| table.header.iter().filter(|name| !name.is_empty()).count();
        let columns = |table: &Result<Self, _>| table.as_ref().map_or(0, named);
        // If several delimiters give the same number of columns, the first of `DELIMITERS` is taken.
        tables.into_iter().rev().max_by_key(columns).unwrap_or_else(|| Err("no delimiter".into()))
    }

    /// Names of the columns, in the order of the file.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// Line number of the header, from 1 on.
    pub fn line(&self) -> usize {
        self.line
    }

    /// The rows of the table. Each row is its line number and its numbers.
    ///
    /// # Errors
    /// One line with the line number in the file, the column, and the allowed values.
    pub fn numbers<const N: usize>(
        &self,
        columns: &[Column<'_>; N],
    ) -> Result<Vec<(usize, [f64; N])>, String> {
        let mut places = [0; N];
        for (place, (column, _)) in places.iter_mut().zip(columns) {
            *place = self.place(column, columns)?;
        }
        let (mut splitter, mut rows) = (Splitter::new(self.delimiter), vec![]);
        for row in lines(self.text).skip(1) {
            let line = row.1;
            if rows.len() == ROWS_MAX {
                return Err(format!("line {line}: more rows than are read, allowed {ROWS_MAX}"));
            }
            let cells = splitter.cells(row)?;
            if cells.len() != self.header.len() {
                return Err(self.uneven(line, cells.len()));
            }
            let mut values = [0.0; N];
            for ((value, place), (column, allowed)) in values.iter_mut().zip(places).zip(columns) {
                let cell = cells[place];
                let number = number(cell, self.delimiter).filter(|number| allowed.contains(number));
                *value = number.ok_or_else(|| {
                    let (cell, allowed) = (cell.chars().take(SHOWN), words(allowed));
                    let cell: String = cell.collect();
                    format!("line {line}: {column} is `{cell}`, allowed {allowed}")
                })?;
            }
            rows.push((line, values));
        }
        Ok(rows)
    }

    fn place(&self, column: &str, needed: &[Column<'_>]) -> Result<usize, String> {
        let mut places = (0..self.header.len()).filter(|place| self.header[*place] == column);
        let line = self.line;
        match (places.next(), places.next()) {
            (Some(place), None) => Ok(place),
            (Some(_), _) => Err(format!("line {line}: several columns {column}, allowed one")),
            (None, _) => {
                let needed: Vec<&str> = needed.iter().map(|(name, _)| *name).collect();
                let (needed, has) = (needed.join(","), self.header.join(","));
                Err(format!("line {line}: no column {column} in `{has}`, needed {needed}"))
            }
        }
    }

    fn uneven(&self, line: usize, cells: usize) -> String {
        let names = self.header.join(",");
        let wrong = match self.header.get(cells) {
            Some(column) => format!("no cell for {column}"),
            None => format!("{cells} cells"),
        };
        format!("line {line}: {wrong}, allowed {} cells: {names}", self.header.len())
    }
}

/// The lines with their numbers, from 1 on. Blank lines and comments are left out. A line ends with LF, CRLF or CR.
fn lines(text: &str) -> impl Iterator<Item = (&str, usize)> {
    let lines =
        text.split('\n').flat_map(|line| line.strip_suffix('\r').unwrap_or(line).split('\r'));
    lines.zip(1..).filter(|(line, _)| {
        let line = trim(line);
        !line.is_empty() && !line.starts_with('#')
    })
}

/// The text without blanks at both ends. Other characters that do not print are not removed, so they make the value
/// invalid.
fn trim(text: &str) -> &str {
    text.trim_matches([' ', '\t'])
}

/// Parses a number with a decimal point. A decimal comma is also allowed, if the comma does not separate cells.
fn number(cell: &str, delimiter: char) -> Option<f64> {
    let has_comma = delimiter != ',' && !cell.contains('.');
    let number = if has_comma { cell.replacen(',', ".", 1).parse() } else { cell.parse() };
    number.ok().filter(|number: &f64| number.is_finite())
}

fn words(allowed: &RangeInclusive<f64>) -> String {
    let [low, high] = ends(allowed);
    match *allowed.end() {
        _ if *allowed == FINITE => "any finite number".into(),
        f64::MAX => format!("a number from {low} on"),
        _ => format!("{low} to {high}"),
    }
}

struct Splitter {
    reader: Reader,
    text: Vec<u8>,
    ends: Vec<usize>,
}

impl Splitter {
    fn new(delimiter: char) -> Self {
        let delimiter = u8::try_from(delimiter).unwrap_or(b',');
        Self {
            reader: ReaderBuilder::new().delimiter(delimiter).build(),
            text: vec![],
            ends: vec![],
        }
    }

    fn cells(&mut self, (line, number): (&str, usize)) -> Result<Vec<&str>, String> {
        if line.len() > LINE_MAX {
            let length = line.len();
            return Err(format!("line {number}: {length} bytes long, allowed {LINE_MAX}"));
        }
        let Self { reader, text, ends } = self;
        reader.reset();
        text.resize(line.len() + 1, 0);
        ends.resize(line.len() + 1, 0);
        let (_, _, written, cells) = reader.read_record(line.as_bytes(), text, ends);
        // If a quote is open, the reader takes the end of the line as one more character of the cell.
        let (result, _, _, last) =
            reader.read_record(b"\n", &mut text[written..], &mut ends[cells..]);
        if !matches!(result, ReadRecordResult::Record) {
            return Err(format!(
                "line {number}: a quote is open at its end, allowed pairs of quotes"
            ));
        }
        let ends = &ends[..cells + last];
        let pairs = iter::once(&0).chain(ends).zip(ends);
        // The text is cut only at delimiters and quotes, so each piece is valid UTF-8.
        Ok(pairs
            .map(|(begin, end)| clean(str::from_utf8(&text[*begin..*end]).unwrap_or_default()))
            .collect())
    }
}

/// The cell without blanks and quotes at its ends. The CSV reader keeps a quote that follows a blank, so it is removed
/// here.
fn clean(cell: &str) -> &str {
    let cell = trim(cell);
    cell.strip_prefix('"').and_then(|cell| cell.strip_suffix('"')).map_or(cell, trim)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(text: &str) -> Vec<String> {
        Table::new(text).unwrap().header
    }

    #[test]
    fn the_delimiter_is_what_makes_most_columns() {
        assert_eq!(header("a,b;c\n"), ["a", "b;c"], "of as many the comma");
        assert_eq!(header("a;b, in m;c"), ["a", "b, in m", "c"]);
        assert_eq!(header("\"a;b;c\",d\te"), ["a;b;c", "d\te"], "none in quotes");
        assert_eq!(header("a\t, b\t, c\t"), ["a", "b", "c"], "nor one that makes empty columns");
        assert_eq!(header("a"), ["a"]);
    }

    #[test]
    fn a_line_has_a_longest_length() {
        let row = |length: usize| format!("a,b\n1,{}", " ".repeat(length - 3) + "2");
        let read = |text: &str| Table::new(text)?.numbers(&[("a", FROM_0), ("b", FINITE)]);
        assert_eq!(read(&row(LINE_MAX)), Ok(vec![(2, [1.0, 2.0])]));
        let long = "line 2: 1048577 bytes long, allowed 1048576";
        assert_eq!(read(&row(LINE_MAX + 1)).unwrap_err(), long);
        assert!(
            Table::new(&"a,".repeat(LINE_MAX)).unwrap_err().starts_with("line 1: 2097152 bytes")
        );
        let low = read("a,b\n-1,2").unwrap_err();
        assert_eq!(low, "line 2: a is `-1`, allowed a number from 0 on");
    }
}
