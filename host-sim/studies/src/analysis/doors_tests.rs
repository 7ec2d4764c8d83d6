//! Tests every function that reads a table of the user. All of them must accept the same forms of a file and refuse the
//! same mistakes.

use std::{collections::BTreeMap, fs, path::Path};

use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use tempfile::TempDir;
use zwidth::telemetry::Flags;

use super::{
    agree::Measured,
    identify::{self, Gain, Options, Span},
    replay,
};
use crate::{
    error::Error,
    scene::{FeltCurve, NamedScene},
};

/// Cells of a table, row by row. The first row is the header.
type Cells = Vec<Vec<String>>;
/// Text of what the function has read, or the error.
type Found = Result<String, Error>;

/// A function that reads a table, and a table that it accepts.
struct Door {
    name: &'static str,
    good: Cells,
    read: Box<dyn Fn(&Path) -> Found>,
    /// Whether the function accepts columns that it does not know.
    others: bool,
}

fn cells(header: &str, rows: impl IntoIterator<Item = Vec<f64>>) -> Cells {
    let header = header.split(',').map(str::to_owned).collect();
    let row = |row: Vec<f64>| row.iter().map(f64::to_string).collect();
    std::iter::once(header).chain(rows.into_iter().map(row)).collect()
}

fn log(name: &'static str, scene: &str, position: &str, size: f64) -> Door {
    let row =
        |n: u32| vec![1.5 + f64::from(n) * 1e-3, 0.5 * f64::from(n % 3), f64::from(n % 7) * size];
    Door {
        name,
        good: cells(&format!("time_s,voltage_v,{position}"), (0..120).map(row)),
        read: identify(scene),
        others: true,
    }
}

fn identify(scene: &str) -> Box<dyn Fn(&Path) -> Found> {
    let base = NamedScene::load(scene).unwrap();
    Box::new(move |path| {
        let options = Options::of_scene(&base.scene, Gain::Given(1.0));
        identify::read(path, (&base, "base"), &options, Span::default())
            .map(|record| format!("{record:?}"))
    })
}

fn doors() -> [Door; 6] {
    let paper = NamedScene::load("paper-1um").unwrap();
    let scene = paper.scene.clone();
    let plan = paper.scene.walk_plan();
    let b = move |n: u32| plan.damping_start_n_s_per_m + f64::from(n) * plan.damping_step_n_s_per_m;
    let columns = "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m";
    let walk = cells(columns, (0..6).map(|n| vec![1500.0, b(n), 4000.5 + f64::from(n)]));
    let curve = (1..6).map(|n| vec![10.5 * f64::from(n), 4e-6 / f64::from(n)]);
    let frame = |n: u32| {
        vec![f64::from(10_000 + 10 * n), f64::from(n % 9), -250.0, 0.0, f64::from(Flags::ON.bits())]
    };
    [
        Door {
            name: "walk",
            good: walk,
            read: Box::new(move |path| {
                Measured::load(path, &paper).map(|found| format!("{found:?}"))
            }),
            others: true,
        },
        Door {
            name: "felt curve",
            good: cells("frequency_hz,threshold_rms_m", curve),
            read: Box::new(|path| {
                let curve = FeltCurve::load(path)?;
                Ok(format!("{:?}", [1.0, 10.5, 17.0, 52.5, 99.0].map(|hz| curve.threshold_m(hz))))
            }),
            others: false,
        },
        log("log", "paper-1um", "position_m", 1e-6),
        log("rotary log", "hapkit", "position_rad", 0.001),
        Door {
            read: Box::new(move |path| {
                let record = replay::read_log(path, &scene, scene.encoder.resolution_m)?;
                Ok(format!("{record:?}"))
            }),
            ..log("ranked log", "paper-1um", "position_m", 1e-6)
        },
        Door {
            name: "telemetry",
            good: cells("sample,position_counts,force_q30,command,flags", (0..120).map(frame)),
            read: identify("paper-1um"),
            others: true,
        },
    ]
}

fn joined(cells: &Cells, between: &str, end: &str) -> String {
    cells.iter().map(|row| row.join(between) + end).collect()
}

fn plain(cells: &Cells) -> String {
    joined(cells, ",", "\n")
}

fn each(cells: &Cells, change: impl Fn(&str) -> String) -> Cells {
    cells.iter().map(|row| row.iter().map(|cell| change(cell)).collect()).collect()
}

/// Other ways to write the good table. Every function must read the same from each of them.
fn taken(good: &Cells, others: bool) -> BTreeMap<&'static str, String> {
    let commas = each(good, |cell| cell.replace('.', ","));
    let noted = plain(good).replace('\n', "\n\t # a, \"b;\n\n  \t \n#\n");
    let mut taken = BTreeMap::from([
        ("as it is", plain(good)),
        ("byte-order mark", format!("\u{feff}{}", plain(good))),
        ("byte-order mark, comment", format!("\u{feff}# x\n{}", plain(good))),
        ("CRLF", joined(good, ",", "\r\n")),
        ("CR", joined(good, ",", "\r")),
        ("no last line end", plain(good).trim_end().to_owned()),
        ("comments and blank lines", format!("# \u{b5}m, \"\n \n{noted}")),
        ("comments in CR", format!("# x\r{}", noted.replace('\n', "\r"))),
        ("quotes", plain(&each(good, |cell| format!("\"{cell}\"")))),
        ("blanks", plain(&each(good, |cell| format!("  {cell}\t ")))),
        ("quotes after blanks", plain(&each(good, |cell| format!(" \"{cell}\" ")))),
        ("semicolons", joined(good, ";", "\n")),
        ("tabs", joined(good, "\t", "\n")),
        ("decimal commas, semicolons", joined(&commas, ";", "\n")),
        ("decimal commas, tabs", joined(&commas, "\t", "\n")),
        ("a spreadsheet's", format!("\u{feff}{}", joined(&commas, ";", "\r\n"))),
        (
            "exponents",
            plain(&each(good, |cell| match cell.parse::<f64>() {
                Ok(number) => format!("{number:+e}"),
                Err(_) => cell.to_owned(),
            })),
        ),
        (
            "another order",
            plain(&good.iter().map(|row| row.iter().rev().cloned().collect()).collect()),
        ),
    ]);
    if others {
        let mut more = good.clone();
        for row in &mut more {
            row.insert(1, "\"a, \"\"b\"\"; c\"".into());
            row.push(String::new());
        }
        taken.insert("unknown columns", plain(&more));
    }
    taken
}

/// Tables that every function must refuse. Each has the message that the function must give.
fn refused(good: &Cells) -> Vec<(Vec<u8>, String)> {
    let header = &good[0];
    let (first, last) = (&header[0], &header[header.len() - 1]);
    let columns = header.len();
    let with = |line: usize, change: &dyn Fn(&mut Vec<String>)| {
        let mut cells = good.clone();
        change(&mut cells[line - 1]);
        cells
    };
    let wide = |text: &str, order: fn(u16) -> [u8; 2]| {
        text.encode_utf16().flat_map(order).collect::<Vec<u8>>()
    };
    let good_text = plain(good);
    let mut refused = vec![
        (
            wide(&format!("\u{feff}{good_text}"), u16::to_le_bytes),
            "not UTF-8, byte 1: UTF-16?".into(),
        ),
        (wide(&good_text, u16::to_le_bytes), "not UTF-8, byte 2: UTF-16?".into()),
        (wide(&good_text, u16::to_be_bytes), "not UTF-8, byte 1: UTF-16?".into()),
        ([b"# \xb5m\n", good_text.as_bytes()].concat(), "not UTF-8, byte 3: Windows-1252?".into()),
    ];
    let mut text = |text: String, why: String| refused.push((text.into_bytes(), why));
    text(String::new(), "the file is empty".into());
    text("# only\n\n".into(), "the file is empty".into());
    let names = header.join(",");
    text(
        plain(&with(3, &|row| row.push("000".into()))),
        format!("line 3: {} cells, allowed {columns} cells: {names}", columns + 1),
    );
    let missing = format!("line 3: no cell for {last}, allowed {columns} cells: {names}");
    let short = with(3, &|row| drop(row.pop()));
    text(plain(&short), missing.clone());
    for end in ["\r\n", "\r"] {
        text(joined(&short, "\t", end), missing.clone());
    }
    text(format!("#\r\r# x\r{}", joined(&short, ";", "\r")), missing.replace("line 3", "line 6"));
    text(
        plain(&with(3, &|row| row[0].insert(0, '"'))),
        "line 3: a quote is open at its end".into(),
    );
    text(
        plain(&good.iter().map(|row| [&row[..], &row[..1]].concat()).collect()),
        format!("line 1: several columns {first}, allowed one"),
    );
    for (column, name) in header.iter().enumerate() {
        for cell in [
            "",
            "x",
            "nan",
            "inf",
            "-inf",
            "1e999",
            "1.5.2",
            "\u{a0}1",
            "\u{2212}1",
            "0x1",
            "1 000",
        ] {
            let shown = format!("line 3: {name} is `{cell}`, allowed ");
            text(plain(&with(3, &|row| row[column] = cell.into())), shown);
        }
        text(
            plain(&with(4, &|row| row[column] = "\"1,5\"".into())),
            format!("line 4: {name} is `1,5`, allowed "),
        );
        for cell in ["1,000,5", "1.000,5", "1,000.5"] {
            let shown = format!("line 2: {name} is `{cell}`, allowed ");
            text(joined(&with(2, &|row| row[column] = cell.into()), ";", "\n"), shown);
        }
        // Without its counts, telemetry would be read as a log without time. That gives another message.
        if name != "position_counts" {
            text(
                plain(&with(1, &|row| row[column] = "other".into())),
                format!("line 1: no column {name} in `"),
            );
        }
    }
    refused
}

/// A temporary folder. It is in memory if possible.
fn folder() -> TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// What the function answers to a file with this content.
fn answer(door: &Door, folder: &Path, content: &[u8]) -> Found {
    let path = folder.join("table.csv");
    fs::write(&path, content).unwrap();
    (door.read)(&path)
}

#[test]
fn every_door_takes_the_same_tables() {
    let folder = folder();
    for door in doors() {
        let good = answer(&door, folder.path(), plain(&door.good).as_bytes()).unwrap();
        for (kind, text) in taken(&door.good, door.others) {
            let found = answer(&door, folder.path(), text.as_bytes());
            let found = found.unwrap_or_else(|error| panic!("{}: {kind}: {error}", door.name));
            assert_eq!(found, good, "{}: {kind}", door.name);
        }
    }
}

#[test]
fn every_door_refuses_the_same_tables_by_line_and_column() {
    let folder = folder();
    for door in doors() {
        for (content, why) in refused(&door.good) {
            let said = match answer(&door, folder.path(), &content) {
                Err(Error::Input(said)) => said,
                other => panic!("{}: {other:?} should be refused: {why}", door.name),
            };
            let file = folder.path().join("table.csv").display().to_string();
            assert!(said.starts_with(&file) && said.contains(&why), "{}: {said}\n{why}", door.name);
        }
    }
}

/// A broken form of the good table: bytes are flipped, inserted and deleted, rows doubled, cells swapped.
fn spoiled(good: &Cells, random: &mut Xoshiro256PlusPlus) -> Vec<u8> {
    const INSERTED: &[u8] = b",;\t\"#\r\n\0 -.e9\xff\xef\xbb\xbf";
    let mut cells = good.clone();
    for _ in 0..random.random_range(0..3) {
        let (row, other) =
            (random.random_range(0..cells.len()), random.random_range(0..cells.len()));
        let (column, to) =
            (random.random_range(0..good[0].len()), random.random_range(0..good[0].len()));
        if random.random() {
            let doubled = cells[row].clone();
            cells.insert(other, doubled);
        } else {
            let cell = cells[row][column].clone();
            cells[row][column] = std::mem::replace(&mut cells[other][to], cell);
        }
    }
    let between = [",", ";", "\t"][random.random_range(0..3)];
    let end = ["\n", "\r\n", "\r"][random.random_range(0..3)];
    let mut bytes = joined(&cells, between, end).into_bytes();
    for _ in 0..random.random_range(0..6) {
        let Some(last) = bytes.len().checked_sub(1) else { break };
        let at = random.random_range(0..=last);
        match random.random_range(0..4) {
            0 => bytes[at] ^= 1 << random.random_range(0..8),
            1 => bytes.insert(at, INSERTED[random.random_range(0..INSERTED.len())]),
            2 => drop(bytes.remove(at)),
            _ if random.random_range(0..10) == 0 => bytes.truncate(at + 1),
            _ => {}
        }
    }
    bytes
}

/// Logs with units in their headers, for example milliseconds and counts.
fn logs_in_units() -> [Door; 2] {
    let of = |name, scene, header| {
        let row =
            |n: u32| vec![1500.0 + f64::from(n), 0.5 * f64::from(n % 3), 3.0 * f64::from(n % 7)];
        Door { name, good: cells(header, (0..120).map(row)), read: identify(scene), others: true }
    };
    [
        of("log of counts", "paper-1um", "Time (ms),Force [N],encoder ticks"),
        of("log of degrees", "hapkit", "t/ms,Torque (mNm),angle (deg)"),
    ]
}

/// What a person reads in a table: its numbers, written plainly. `None` if the table is broken. Tables with quotes are
/// not judged.
fn as_read(content: &[u8]) -> Option<String> {
    let text = str::from_utf8(content).ok()?;
    let text = text.trim_start_matches('\u{feff}').replace("\r\n", "\n").replace('\r', "\n");
    let is_row = |line: &&str| !line.trim().is_empty() && !line.trim().starts_with('#');
    let mut lines = text.lines().filter(is_row);
    let names = lines.next()?;
    let between = ['\t', ';', ','].into_iter().max_by_key(|one| names.split(*one).count())?;
    let trimmed = |line: &str| line.split(between).map(|cell| cell.trim().to_owned()).collect();
    let header: Vec<String> = trimmed(names);
    let mut plain = header.join(between.encode_utf8(&mut [0])) + "\n";
    for line in lines {
        let row: Vec<String> = trimmed(line);
        let number = |cell: &String| {
            let comma = between != ',' && !cell.contains('.');
            let cell = if comma { cell.replacen(',', ".", 1) } else { cell.clone() };
            cell.parse::<f64>().ok().filter(|number| number.is_finite())
        };
        let numbers: Option<Vec<f64>> = row.iter().map(number).collect();
        let numbers = numbers.filter(|numbers| numbers.len() == header.len())?;
        let cells: Vec<String> = numbers.iter().map(f64::to_string).collect();
        plain += &(cells.join(between.encode_utf8(&mut [0])) + "\n");
    }
    Some(plain)
}

fn none_is_misread(cases: u32) {
    let folder = folder();
    for door in doors().into_iter().chain(logs_in_units()) {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut taken = 0;
        for _ in 0..cases {
            let content = spoiled(&door.good, &mut random);
            match answer(&door, folder.path(), &content) {
                Ok(_) if content.contains(&b'"') => taken += 1,
                Ok(found) => {
                    let shown = String::from_utf8_lossy(&content);
                    let read =
                        as_read(&content).unwrap_or_else(|| panic!("{}: {shown}", door.name));
                    let again = answer(&door, folder.path(), read.as_bytes());
                    assert!(
                        matches!(&again, Ok(again) if *again == found),
                        "{}: {shown}",
                        door.name
                    );
                    taken += 1;
                }
                Err(Error::Input(_)) => {}
                Err(other) => panic!("{}: {other}", door.name),
            }
        }
        println!("{}: {taken} of {cases} taken", door.name);
        assert!(taken > cases / 20 && taken < cases / 2, "{}: {taken} taken", door.name);
    }
}

#[test]
fn a_spoiled_table_is_read_as_a_person_would_or_refused() {
    none_is_misread(2000);
}

#[test]
#[ignore = "twenty times as many; .ci/long runs it"]
fn many_spoiled_tables_are_read_as_a_person_would_or_refused() {
    none_is_misread(40_000);
}
