//! A record has a command and a measured position in equal steps of time. The command is a voltage, a force or a
//! current.

use std::{fmt::Write as _, ops::RangeInclusive};

use super::columns::{Columns, Drive};
use crate::{
    input::table::{FINITE, Table},
    scene::Units,
};

/// Smallest number of rows in a record.
pub const FEWEST_ROWS: usize = 100;
/// Largest number of rows in a record: 100 s at 10 kHz. An identification with so many rows takes half a minute.
pub const MOST_ROWS: usize = 1_000_000;
/// Largest distance of a time stamp from an even grid, in steps. The tolerance allows time stamps with few digits.
const JITTER_MAX: f64 = 0.1;
/// Allowed time between two rows, in s. It begins at 10 us (100 kHz), and its end is slow enough for any hand-held
/// device.
const STEP_S: RangeInclusive<f64> = 1e-5..=0.1;
/// Hint in an error message if positions are a thousand times too large.
pub(super) const IN_MM: &str = "; position_m is in m: are these mm?";
/// Largest travel of a handle, in m. There is no limit for an angle.
const TRAVEL_MAX_M: f64 = 5.0;
/// Change of the position when a 16-bit counter wraps, in counts.
const WRAP: f64 = 65_536.0;
/// Command and position on an even grid of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Name in error messages.
    pub name: String,
    /// Time of the first row, in s.
    pub start_s: f64,
    pub step_s: f64,
    pub drive: Drive,
    /// Command of each row, in V, N or A. It is constant until the next row.
    pub command: Vec<f64>,
    /// Position that the sensor measured at each row, in m.
    pub position_m: Vec<f64>,
    /// Whether the amplifier may have clipped the voltage. This is false for telemetry, because telemetry has the
    /// voltage that acted.
    pub may_clip: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Row {
    pub line: usize,
    pub time_s: f64,
    pub command: f64,
    pub position_m: f64,
}

/// A part of a record. Two time stamps of the file delimit it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Span {
    /// Time of the first row in s; `None` for the beginning of the record.
    pub from_s: Option<f64>,
    /// Time of the last row in s; `None` for the end of the record.
    pub to_s: Option<f64>,
}

impl Span {
    pub(super) fn of<T>(
        &self,
        mut rows: Vec<T>,
        time_s: impl Fn(&T) -> f64,
    ) -> Result<Vec<T>, String> {
        let [Some(first), Some(last)] = [rows.first(), rows.last()].map(|row| row.map(&time_s))
        else {
            return Err("no row of data".into());
        };
        rows.retain(|row| {
            let time_s = time_s(row);
            self.from_s.is_none_or(|from_s| time_s >= from_s)
                && self.to_s.is_none_or(|to_s| time_s <= to_s)
        });
        if rows.is_empty() {
            return Err(format!(
                "no row of data between --from and --to, allowed {first} to {last} s"
            ));
        }
        Ok(rows)
    }
}

impl Record {
    /// Reads a log with columns for time, command and position. The order of columns is free. Other columns are
    /// ignored. A resolution of 0 is for a sensor without counts.
    ///
    /// # Errors
    /// The text is no log. The message has one line with the error and its place.
    pub fn from_csv(
        name: &str,
        text: &str,
        span: Span,
        units: Units,
        resolution_m: f64,
    ) -> Result<Self, String> {
        let table = Table::new(text)?;
        let Columns { of, drive } = Columns::find(table.header(), units, resolution_m)
            .map_err(|error| format!("line {}: {error}", table.line()))?;
        let rows = table.numbers(&of.map(|(column, _)| (column, FINITE)))?;
        let [seconds, units_of_command, metres] = of.map(|(_, factor)| factor);
        let rows = rows.into_iter().map(|(line, [time, command, position])| Row {
            line,
            time_s: time * seconds,
            command: command * units_of_command,
            position_m: position * metres,
        });
        let rows = span.of(rows.collect(), |row: &Row| row.time_s)?;
        let mut record = Self::even(name, &rows, resolution_m, "line")?;
        (record.drive, record.may_clip) = (drive, drive == Drive::Voltage);
        let (low, high) = range(&record.position_m);
        if units == Units::Linear && high - low > TRAVEL_MAX_M {
            let travel_m = high - low;
            return Err(format!(
                "the position moves by {travel_m:.3} m, allowed {TRAVEL_MAX_M} m{IN_MM}"
            ));
        }
        Ok(record)
    }

    /// Makes a record from rows with even time stamps. Error messages name the number of a row with `place`.
    pub(super) fn even(
        name: &str,
        rows: &[Row],
        resolution_m: f64,
        place: &str,
    ) -> Result<Self, String> {
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
        // The median is used, because a gap in the time stamps does not change it.
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
        if let Some((line, counts)) = wrap(rows, resolution_m) {
            return Err(format!(
                "{place} {line}: the position goes by {counts} counts, as a counter of 16 bits does when it wraps; \
                 allowed are positions without wraps"
            ));
        }
        Ok(Self {
            name: name.into(),
            start_s: first.time_s,
            step_s,
            drive: Drive::Voltage,
            command: rows.iter().map(|row| row.command).collect(),
            position_m: rows.iter().map(|row| row.position_m).collect(),
            may_clip: true,
        })
    }

    /// Refuses columns that cannot come from a log.
    pub(super) fn check(&self) -> Result<(), String> {
        let is_finite = |column: &[f64]| column.iter().all(|value| value.is_finite());
        if self.command.len() != self.len() {
            return Err(format!("{} commands and {} positions", self.command.len(), self.len()));
        }
        if !(self.start_s.is_finite() && is_finite(&self.command) && is_finite(&self.position_m)) {
            return Err("a time, command or position is not finite".into());
        }
        in_range(self.step_s)
    }

    /// The record as a log that [`from_csv`](Self::from_csv) reads. All numbers except the time stamps keep every bit.
    pub fn csv(&self) -> String {
        let mut text = format!("time_s,{},position_m\n", self.command_column());
        for (n, (command, position_m)) in self.command.iter().zip(&self.position_m).enumerate() {
            let _ = writeln!(text, "{:.7},{command},{position_m}", self.time_s(n));
        }
        text
    }

    pub fn command_column(&self) -> &'static str {
        match self.drive {
            Drive::Voltage => "voltage_v",
            Drive::Force => "force_n",
            Drive::Current => "current_a",
        }
    }

    pub fn time_s(&self, row: usize) -> f64 {
        self.start_s + row as f64 * self.step_s
    }

    pub fn len(&self) -> usize {
        self.position_m.len()
    }

    pub fn is_empty(&self) -> bool {
        self.position_m.is_empty()
    }
}

pub(super) fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(*value), high.max(*value))
    })
}

fn in_range(step_s: f64) -> Result<(), String> {
    let (low, high) = (STEP_S.start(), STEP_S.end());
    if STEP_S.contains(&step_s) {
        Ok(())
    } else {
        Err(format!("a row every {step_s} s, allowed {low} to {high} s"))
    }
}

/// Finds a step of about 2^16 counts between small steps. Returns the line and the size of the first one.
fn wrap(rows: &[Row], resolution_m: f64) -> Option<(usize, f64)> {
    let steps = rows.windows(2).map(|pair| {
        let moved_m = pair[1].position_m - pair[0].position_m;
        (pair[1].line, (moved_m / resolution_m).round())
    });
    let steps: Vec<(usize, f64)> = steps.collect();
    let is_small =
        |step: Option<&(usize, f64)>| step.is_none_or(|(_, step)| step.abs() < 0.25 * WRAP);
    let is_wrap = |(n, (_, step)): &(usize, &(usize, f64))| {
        (step.abs() - WRAP).abs() < 0.25 * WRAP
            && is_small(n.checked_sub(1).and_then(|n| steps.get(n)))
            && is_small(steps.get(n + 1))
    };
    steps.iter().enumerate().find(is_wrap).map(|(_, step)| *step)
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
        Record::from_csv("log", text, Span::default(), Units::Linear, 1e-6)
    }

    #[test]
    fn a_log_comes_back() {
        let record = read(&log(200, |n, fields| fields[1] = format!("{}", n % 3))).unwrap();
        assert_eq!((record.len(), record.command[5], record.position_m[6]), (200, 2.0, 6e-6));
        assert!((record.step_s - 1e-4).abs() < 1e-12);
        let again = read(&record.csv()).unwrap();
        assert_eq!((&again.command, &again.position_m), (&record.command, &record.position_m));
        let part = Span { from_s: Some(0.005), to_s: Some(0.0151) };
        let part = Record::from_csv("log", &record.csv(), part, Units::Linear, 1e-6).unwrap();
        assert_eq!((part.len(), part.start_s), (102, 0.005));
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
            (log(0, |_, _| ()), "no row of data"),
            (log(99, |_, _| ()), "99 rows of data, at least 100 are needed"),
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

    #[test]
    fn a_part_is_of_any_time_that_the_file_has() {
        let text = log(200, |n, fields| fields[0] = format!("{:.4}", 1.7e9 + n as f64 * 1e-3));
        let part = |from_s, to_s| {
            let span = Span { from_s: Some(from_s), to_s: Some(to_s) };
            Record::from_csv("log", &text, span, Units::Linear, 1e-6)
        };
        let record = part(1.7e9 + 0.0499, 1.7e9 + 0.1501).unwrap();
        assert_eq!((record.len(), record.start_s), (101, 1.7e9 + 0.05));
        let none = "no row of data between --from and --to, allowed 1700000000 to 1700000000.199 s";
        assert_eq!(part(0.0, 1.0).unwrap_err(), none);
    }

    #[test]
    fn a_wrap_of_16_bits_is_named_with_its_line() {
        let counts = |of: fn(f64) -> f64, resolution: f64| {
            let text = log(200, |n, fields| {
                fields[2] = format!("{}", of(n as f64 * 300.0) * resolution);
            });
            Record::from_csv("log", &text, Span::default(), Units::Linear, resolution)
        };
        let unsigned = |count: f64| (count + 30_000.0).rem_euclid(65_536.0);
        let error = counts(unsigned, 1e-6).unwrap_err();
        // With 300 counts per row, the position 30,000 + 300 * 119 is the first at or above 65,536.
        let wrapped = "line 121: the position goes by -65236 counts, as a counter of 16 bits";
        assert!(error.starts_with(wrapped), "{error}");
        let signed = |count: f64| (count + 32_768.0).rem_euclid(65_536.0) - 32_768.0;
        assert!(counts(signed, 1e-4).unwrap_err().starts_with("line 112: "));
        let down = |count: f64| (-count).rem_euclid(65_536.0);
        assert!(counts(down, 1e-4).unwrap_err().contains("goes by 65236 counts"));
        // Three records are accepted: of a counter without wraps, of a sensor without counts, and of a handle that
        // always moves at this speed.
        assert!(counts(|count| count, 1e-6).is_ok());
        assert!(counts(|count| 200.0 * count, 1e-9).is_ok());
        let text =
            log(200, |n, fields| fields[2] = format!("{}", unsigned(n as f64 * 300.0) * 1e-6));
        assert!(Record::from_csv("log", &text, Span::default(), Units::Linear, 0.0).is_ok());
    }
}
