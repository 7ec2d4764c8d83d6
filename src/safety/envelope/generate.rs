//! `envelope.csv` of a sweep to Rust source: for the build script of the firmware, which takes this
//! file in by `#[path = "src/safety/envelope/generate.rs"] mod generate;`. It needs `std` and nothing else.

use std::{fmt::Write as _, format, string::String, vec::Vec};

/// Columns of `envelope.csv`.
pub const HEADER: &str = "device,estimator,cutoff_hz,latency_samples,period_samples,damping_n_s_per_m,\
     stiffness_low_n_per_m,stiffness_high_n_per_m";

struct Row<'a> {
    device: &'a str,
    estimator: &'a str,
    /// Cutoff, latency, period, B, lowest K, highest K.
    numbers: [f64; 6],
}

/// An item `pub static NAME: Envelope<'static>` with the table in `csv`, for `include!` where
/// `Envelope`, `Boundary`, `Key` and `Point` of `zwidth::safety::envelope` are in scope. Rows of one key
/// need not stand together. An empty `csv`, or one with the header only, gives an empty table.
///
/// # Errors
/// One line that names the row and what is wrong with it.
pub fn generate(name: &str, csv: &str) -> Result<String, String> {
    let mut lines = csv.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    match lines.next() {
        Some((_, header)) if header.trim() != HEADER => {
            return Err(format!("line 1: the header must be {HEADER}"));
        }
        _ => {}
    }
    let mut boundaries: Vec<(Row<'_>, Vec<[f64; 3]>)> = Vec::new();
    for (n, line) in lines {
        let row = parse(line).map_err(|why| format!("line {}: {why}", n + 1))?;
        let [cutoff, latency, period, damping, low, high] = row.numbers;
        if low > high {
            return Err(format!("line {}: stiffness_low_n_per_m is above the high one", n + 1));
        }
        let known = boundaries.iter_mut().find(|(key, _)| {
            key.device == row.device
                && key.estimator == row.estimator
                && key.numbers[..3] == [cutoff, latency, period]
        });
        match known {
            Some((_, points)) => points.push([damping, low, high]),
            None => boundaries.push((row, Vec::from([[damping, low, high]]))),
        }
    }
    let mut text = format!(
        "/// Predicted-stable walls, from a sweep.\npub static {name}: Envelope<'static> = Envelope {{\n    boundaries: &[\n"
    );
    for (key, points) in &mut boundaries {
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        if let Some(pair) = points.windows(2).find(|pair| pair[0][0] == pair[1][0]) {
            return Err(format!(
                "{}, {}, {} Hz: damping_n_s_per_m {} stands there twice",
                key.device, key.estimator, key.numbers[0], pair[0][0]
            ));
        }
        // {:?} of a float is the shortest text that reads back to the same bits.
        let _ = writeln!(
            text,
            "        Boundary {{\n            key: Key {{ device: {:?}, estimator: {:?}, cutoff_hz: {:?}, latency_samples: {:?}, period_samples: {:?} }},\n            points: &[",
            key.device, key.estimator, key.numbers[0], key.numbers[1], key.numbers[2]
        );
        for [damping, low, high] in points {
            let _ = writeln!(
                text,
                "                Point {{ damping_n_s_per_m: {damping:?}, stiffness_low_n_per_m: {low:?}, stiffness_high_n_per_m: {high:?} }},"
            );
        }
        text.push_str("            ],\n        },\n");
    }
    text.push_str("    ],\n};\n");
    Ok(text)
}

fn parse(line: &str) -> Result<Row<'_>, String> {
    let fields: Vec<&str> = line.split(',').map(str::trim).collect();
    let &[device, estimator, cutoff, latency, period, damping, low, high] = fields.as_slice()
    else {
        return Err(format!("{} fields, 8 are allowed", fields.len()));
    };
    let mut numbers = [0.0; 6];
    let names = [
        "cutoff_hz",
        "latency_samples",
        "period_samples",
        "damping_n_s_per_m",
        "stiffness_low_n_per_m",
        "stiffness_high_n_per_m",
    ];
    let texts = [cutoff, latency, period, damping, low, high];
    for ((place, text), name) in numbers.iter_mut().zip(texts).zip(names) {
        *place = text
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite() && *value >= 0.0)
            .ok_or_else(|| format!("{name} is {text}, a number from 0 is allowed"))?;
    }
    for (name, text) in [("device", device), ("estimator", estimator)] {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if text.is_empty() || !text.chars().all(plain) {
            return Err(format!("{name} is {text:?}, letters, digits and -_. are allowed"));
        }
    }
    Ok(Row { device, estimator, numbers })
}

#[cfg(test)]
mod tests {
    use super::*;

    mod golden {
        pub use crate::safety::envelope::{Boundary, Envelope, Key, Point};
        include!("../../../tests/golden/envelope.rs");
    }

    fn with_rows(rows: &str) -> Result<String, String> {
        generate("TABLE", &format!("{HEADER}\n{rows}"))
    }

    #[test]
    fn rows_become_a_static_table() {
        let text = with_rows("a,butterworth,1500,10.5,10,20,0.05,0.1\na,butterworth,50,10.5,10,10,0,7\na,butterworth,1500,10.5,10,10,0,5000\n").unwrap();
        let expected = "/// Predicted-stable walls, from a sweep.
pub static TABLE: Envelope<'static> = Envelope {
    boundaries: &[
        Boundary {
            key: Key { device: \"a\", estimator: \"butterworth\", cutoff_hz: 1500.0, latency_samples: 10.5, period_samples: 10.0 },
            points: &[
                Point { damping_n_s_per_m: 10.0, stiffness_low_n_per_m: 0.0, stiffness_high_n_per_m: 5000.0 },
                Point { damping_n_s_per_m: 20.0, stiffness_low_n_per_m: 0.05, stiffness_high_n_per_m: 0.1 },
            ],
        },
        Boundary {
            key: Key { device: \"a\", estimator: \"butterworth\", cutoff_hz: 50.0, latency_samples: 10.5, period_samples: 10.0 },
            points: &[
                Point { damping_n_s_per_m: 10.0, stiffness_low_n_per_m: 0.0, stiffness_high_n_per_m: 7.0 },
            ],
        },
    ],
};
";
        assert_eq!(text, expected);
    }

    #[test]
    fn the_generated_source_compiles_and_works() {
        use golden::{GOLDEN, Key};
        let csv = include_str!("../../../tests/golden/envelope.csv");
        assert_eq!(
            generate("GOLDEN", csv).unwrap(),
            include_str!("../../../tests/golden/envelope.rs")
        );
        let key = Key {
            device: "paper-1um",
            estimator: "butterworth",
            cutoff_hz: 1500.0,
            latency_samples: 10.0,
            period_samples: 10.0,
        };
        assert!(GOLDEN.allows(&key, 4000.0, 10.0).is_ok());
        assert!(GOLDEN.allows(&key, 4001.0, 10.0).is_err());
        assert!(GOLDEN.allows(&key, 1999.0, 20.0).is_err());
        assert!(GOLDEN.allows(&key, 2000.0, 20.0).is_ok());
    }

    #[test]
    fn nothing_gives_an_empty_table() {
        let empty = "/// Predicted-stable walls, from a sweep.\npub static TABLE: Envelope<'static> = Envelope {\n    boundaries: &[\n    ],\n};\n";
        assert_eq!(generate("TABLE", "").unwrap(), empty);
        assert_eq!(with_rows("").unwrap(), empty);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let error = |rows| with_rows(rows).unwrap_err();
        assert_eq!(error("a,b,1,2,10,3,4\n"), "line 2: 7 fields, 8 are allowed");
        assert_eq!(
            error("\na,b,1,2,10,3,0,x\n"),
            "line 3: stiffness_high_n_per_m is x, a number from 0 is allowed"
        );
        assert!(error("a,b,NaN,2,10,3,0,4\n").starts_with("line 2: cutoff_hz"));
        assert!(error("a\",b,1,2,10,3,0,4\n").starts_with("line 2: device"));
        assert!(error("a,b,1,2,10,3,0,4\na,b,1,2,10,3,0,5\n").ends_with("3 stands there twice"));
        assert_eq!(
            error("a,b,1,2,10,3,5,4\n"),
            "line 2: stiffness_low_n_per_m is above the high one"
        );
        assert!(generate("TABLE", "x,y\n").unwrap_err().starts_with("line 1"));
    }
}
