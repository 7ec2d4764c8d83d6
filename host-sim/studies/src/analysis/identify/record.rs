//! A record: the voltage that was commanded and the position that followed, in even steps of time.

use std::{fmt::Write as _, ops::RangeInclusive};

/// Fewest rows of a record.
pub const FEWEST_ROWS: usize = 100;
/// Most rows of a record: 100 s at 10 kHz, which take half a minute.
pub const MOST_ROWS: usize = 1_000_000;
/// Most rows of a file, of which a part may be the record.
const ROWS_MAX: usize = 8_000_000;
/// Largest deviation of a time stamp from an even grid, in steps. Time stamps of few digits stay below it.
const JITTER_MAX: f64 = 0.1;
/// Steps of time between rows, s: up to 100 kHz, and slow enough for any hand-held device.
const STEP_S: RangeInclusive<f64> = 1e-5..=0.1;
/// Columns of a log.
pub const COLUMNS: [&str; 3] = ["time_s", "voltage_v", "position_m"];

/// Voltage and position on an even grid of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// What errors call it.
    pub name: String,
    /// Time of the first row, s.
    pub start_s: f64,
    /// Time between rows, s.
    pub step_s: f64,
    /// Command of each row, V; it is held until the next one.
    pub voltage_v: Vec<f64>,
    /// Position at each row as the sensor gave it, m.
    pub position_m: Vec<f64>,
    /// The voltage is what was asked for, so that the amplifier may have clipped it. Telemetry says what acted.
    pub may_clip: bool,
}

/// One row of a log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Row {
    /// Line of the file.
    pub line: usize,
    pub time_s: f64,
    pub voltage_v: f64,
    pub position_m: f64,
}

/// Part of a record, in the time of its own stamps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Span {
    /// First time, s; from the beginning without it.
    pub from_s: Option<f64>,
    /// Last time, s; to the end without it.
    pub to_s: Option<f64>,
}

impl Span {
    pub(super) fn holds(&self, time_s: f64) -> bool {
        self.from_s.is_none_or(|from_s| time_s >= from_s)
            && self.to_s.is_none_or(|to_s| time_s <= to_s)
    }
}

impl Record {
    /// Reads a log with the columns `time_s,voltage_v,position_m` in any order; further columns are ignored, and
    /// so are empty lines and lines that begin with `#`.
    ///
    /// # Errors
    /// One line: what is wrong, and where.
    pub fn from_csv(name: &str, text: &str, span: Span) -> Result<Self, String> {
        Self::from_columns(name, text, span, (COLUMNS[2], 1.0))
    }

    /// The same with the column `position_rad` of a handle at this radius in place of `position_m`.
    ///
    /// # Errors
    /// As [`from_csv`](Self::from_csv).
    pub fn from_rotary_csv(
        name: &str,
        text: &str,
        span: Span,
        radius_m: f64,
    ) -> Result<Self, String> {
        Self::from_columns(name, text, span, ("position_rad", radius_m))
    }

    fn from_columns(
        name: &str,
        text: &str,
        span: Span,
        (position, metres): (&str, f64),
    ) -> Result<Self, String> {
        let table = Table::new(text, &[COLUMNS[0], COLUMNS[1], position])?;
        let rows = table.rows.into_iter().map(|(line, [time_s, voltage_v, position])| Row {
            line,
            time_s,
            voltage_v,
            position_m: position * metres,
        });
        let rows: Vec<Row> = rows.filter(|row| span.holds(row.time_s)).collect();
        Self::even(name, &rows, "line")
    }

    /// The record of rows whose time stamps must be even; `place` is what a row's number is called.
    pub(super) fn even(name: &str, rows: &[Row], place: &str) -> Result<Self, String> {
        let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
            return Err("no row of data".into());
        };
        if rows.len() < FEWEST_ROWS {
            return Err(format!("{} rows of data, at least {FEWEST_ROWS} are needed", rows.len()));
        }
        if rows.len() > MOST_ROWS {
            return Err(format!(
                "{} rows of data, allowed {FEWEST_ROWS} to {MOST_ROWS}; --from and --to take a part",
                rows.len()
            ));
        }
        let step_s = (last.time_s - first.time_s) / (rows.len() - 1) as f64;
        if let Some(pair) = rows.windows(2).find(|pair| pair[1].time_s <= pair[0].time_s) {
            let (before, after) = (pair[0].time_s, pair[1].time_s);
            let line = pair[1].line;
            return Err(format!(
                "{place} {line}: time goes from {before} s to {after} s; it must rise"
            ));
        }
        in_range(step_s)?;
        // The usual step, which a gap does not change.
        let mut steps: Vec<f64> =
            rows.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).collect();
        steps.sort_by(f64::total_cmp);
        let usual_s = steps[steps.len() / 2];
        let uneven = |step: f64| !(0.5..1.5).contains(&(step / usual_s));
        if let Some(pair) = rows.windows(2).find(|pair| uneven(pair[1].time_s - pair[0].time_s)) {
            let (before, after) = (pair[0].time_s, pair[1].time_s);
            return Err(format!(
                "{place} {}: the time stamps are not even: from {before} s to {after} s where {usual_s:.6} s is \
                 usual; what acted in between is not known",
                pair[1].line
            ));
        }
        for (n, row) in rows.iter().enumerate() {
            let off = (row.time_s - first.time_s) / step_s - n as f64;
            if off.abs() > JITTER_MAX {
                return Err(format!(
                    "{place} {}: the time stamps are not even: {} s is {:.2} steps of {step_s:.6} s off, allowed \
                     {JITTER_MAX}",
                    row.line, row.time_s, off
                ));
            }
        }
        Ok(Self {
            name: name.into(),
            start_s: first.time_s,
            step_s,
            voltage_v: rows.iter().map(|row| row.voltage_v).collect(),
            position_m: rows.iter().map(|row| row.position_m).collect(),
            may_clip: true,
        })
    }

    /// Refuses columns that no file is read into.
    pub(super) fn check(&self) -> Result<(), String> {
        let is_finite = |column: &[f64]| column.iter().all(|value| value.is_finite());
        if self.voltage_v.len() != self.len() {
            return Err(format!("{} voltages and {} positions", self.voltage_v.len(), self.len()));
        }
        if !(self.start_s.is_finite() && is_finite(&self.voltage_v) && is_finite(&self.position_m))
        {
            return Err("a time, voltage or position is not finite".into());
        }
        in_range(self.step_s)
    }

    /// The log of this record, as [`from_csv`](Self::from_csv) reads it. The numbers come back to the bit but for
    /// the time stamps.
    pub fn csv(&self) -> String {
        let mut text = COLUMNS.join(",") + "\n";
        for (n, (voltage_v, position_m)) in self.voltage_v.iter().zip(&self.position_m).enumerate()
        {
            let _ = writeln!(text, "{:.7},{voltage_v},{position_m}", self.time_s(n));
        }
        text
    }

    /// Time of row n, s.
    pub fn time_s(&self, row: usize) -> f64 {
        self.start_s + row as f64 * self.step_s
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.position_m.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.position_m.is_empty()
    }
}

fn in_range(step_s: f64) -> Result<(), String> {
    let (low, high) = (STEP_S.start(), STEP_S.end());
    if STEP_S.contains(&step_s) {
        Ok(())
    } else {
        Err(format!("a row every {step_s} s, allowed {low} to {high} s"))
    }
}

/// Without the blanks at both ends. What else does not print stays, and is refused as a value.
fn trim(text: &str) -> &str {
    text.trim_matches([' ', '\t', '\r'])
}

/// The wanted columns of a text with a header.
pub(super) struct Table<const N: usize> {
    /// Line of the file, values.
    pub rows: Vec<(usize, [f64; N])>,
}

impl<const N: usize> Table<N> {
    pub(super) fn new(text: &str, columns: &[&str; N]) -> Result<Self, String> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let lines = text.lines().map(trim).enumerate();
        let mut lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let (_, header) = lines.next().ok_or("the file is empty")?;
        let names: Vec<&str> = header.split(',').map(trim).collect();
        if let (1, Some(separator)) = (names.len(), header.find([';', '\t', '|', ' '])) {
            let separator = header[separator..].chars().next().unwrap_or_default();
            return Err(format!("columns are separated by `{separator}`, allowed `,`"));
        }
        if let Some(column) =
            columns.iter().find(|column| names.iter().filter(|name| name == column).count() > 1)
        {
            return Err(format!("the first line has several columns {column}, allowed one"));
        }
        let mut places = [0; N];
        for (place, column) in places.iter_mut().zip(columns) {
            *place = names.iter().position(|name| name == column).ok_or_else(|| {
                format!(
                    "no column {column} in the first line; the columns are {}",
                    columns.join(",")
                )
            })?;
        }
        let (mut rows, mut fields) = (vec![], vec![]);
        for (index, line) in lines {
            fields.clear();
            fields.extend(line.split(',').map(trim));
            let line = index + 1;
            if rows.len() == ROWS_MAX {
                return Err(format!("line {line}: more rows than are read, allowed {ROWS_MAX}"));
            }
            if fields.len() != names.len() {
                return Err(format!(
                    "line {line}: {} fields, the first line has {}",
                    fields.len(),
                    names.len()
                ));
            }
            let mut values = [0.0; N];
            for ((value, place), column) in values.iter_mut().zip(places).zip(columns) {
                let field = fields[place];
                *value = field.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(
                    || {
                        let field: String = field.chars().take(30).collect();
                        format!("line {line}: {column} is `{field}`, allowed any finite number")
                    },
                )?;
            }
            rows.push((line, values));
        }
        Ok(Self { rows })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(rows: usize, change: impl Fn(usize, &mut [String; 3])) -> String {
        let mut text = String::from("time_s,voltage_v,position_m\n");
        for n in 0..rows {
            let mut fields =
                [format!("{:.4}", n as f64 * 1e-4), "0".into(), format!("{}e-6", n % 7)];
            change(n, &mut fields);
            text += &(fields.join(",") + "\n");
        }
        text
    }

    fn read(text: &str) -> Result<Record, String> {
        Record::from_csv("log", text, Span::default())
    }

    #[test]
    fn a_log_comes_back() {
        let record = read(&log(200, |n, fields| fields[1] = format!("{}", n % 3))).unwrap();
        assert_eq!((record.len(), record.voltage_v[5], record.position_m[6]), (200, 2.0, 6e-6));
        assert!((record.step_s - 1e-4).abs() < 1e-12);
        let again = read(&record.csv()).unwrap();
        assert_eq!((&again.voltage_v, &again.position_m), (&record.voltage_v, &record.position_m));
        let part = Span { from_s: Some(0.005), to_s: Some(0.0151) };
        let part = Record::from_csv("log", &record.csv(), part).unwrap();
        assert_eq!((part.len(), part.start_s), (102, 0.005));
    }

    #[test]
    fn other_columns_orders_and_line_ends_are_taken() {
        let text = log(120, |_, fields| fields.reverse());
        let text = text.replacen("time_s,voltage_v,position_m", "position_m,voltage_v,time_s", 1);
        assert_eq!(read(&text).unwrap().len(), 120);
        let text = format!(
            "\u{feff}# made by hand\r\n\r\n{}",
            log(120, |_, _| ()).replace('\n', ",9\r\n")
        );
        assert_eq!(read(&text.replacen(",9", ",extra", 1)).unwrap().len(), 120);
    }

    #[test]
    fn what_cannot_be_read_is_named_with_its_line() {
        let set = |n: usize, column: usize, to: &'static str| {
            log(200, move |row, fields| {
                if row == n {
                    fields[column] = to.into();
                }
            })
        };
        for (text, wanted) in [
            (String::new(), "the file is empty"),
            ("time,u,x\n0,0,0\n".into(), "no column time_s in the first line"),
            (log(9, |_, _| ()).replace(',', ";"), "columns are separated by `;`, allowed `,`"),
            (log(9, |_, _| ()).replace(',', "\t"), "columns are separated by `\t`, allowed `,`"),
            (
                log(9, |_, _| ()).replacen("voltage_v", "time_s", 1),
                "the first line has several columns time_s, allowed one",
            ),
            (set(7, 2, "\u{a0}1"), "line 9: position_m is `\u{a0}1`"),
            (log(0, |_, _| ()), "no row of data"),
            (log(99, |_, _| ()), "99 rows of data, at least 100 are needed"),
            (set(7, 2, "nan"), "line 9: position_m is `nan`, allowed any finite number"),
            (set(7, 1, "inf"), "line 9: voltage_v is `inf`"),
            (set(7, 1, ""), "line 9: voltage_v is ``"),
            (set(7, 1, "1,2"), "line 9: 4 fields, the first line has 3"),
            (set(7, 0, "0.0006"), "line 9: time goes from 0.0006 s to 0.0006 s; it must rise"),
            (set(199, 0, "0.5"), "line 201: the time stamps are not even: from 0.0198 s to 0.5 s"),
            (
                log(200, |n, fields| {
                    fields[0] = format!("{:.6}", n as f64 * 1e-4 + if n == 50 { 2e-5 } else { 0.0 })
                }),
                "line 52: the time stamps are not even",
            ),
            (
                log(200, |n, fields| fields[0] = format!("{n}")),
                "a row every 1 s, allowed 0.00001 to 0.1 s",
            ),
        ] {
            let error = read(&text).unwrap_err();
            assert!(error.contains(wanted), "{error} should say {wanted}");
        }
    }
}
