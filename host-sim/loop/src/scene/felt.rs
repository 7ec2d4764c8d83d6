//! The least motion that a hand feels, by frequency: a threshold curve, read from a small file.
//!
//! The curve that is built in is a model (`host-sim/data/felt-model.csv` says what of); `wall_hit.felt_curve` names
//! another one.

use std::{path::Path, sync::Arc};

use crate::{error::Error, input};

/// What is felt unless a scene names a curve.
const MODEL: &str = include_str!("../../../data/felt-model.csv");
const HEADER: &str = "frequency_hz,threshold_rms_m";

/// Frequencies and thresholds: straight lines between them in log-log, constant beyond its ends.
#[derive(Clone, Debug, PartialEq)]
pub struct FeltCurve {
    /// Hz and m RMS, frequencies rising.
    points: Arc<[[f64; 2]]>,
    /// The text that it was read from; `None`: the model that is built in.
    text: Option<Arc<str>>,
}

impl Default for FeltCurve {
    fn default() -> Self {
        Self { points: parse(MODEL).unwrap_or_default().into(), text: None }
    }
}

impl FeltCurve {
    /// Reads a curve.
    ///
    /// # Errors
    /// The file cannot be read, or is no curve.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let text = input::read_text(path, input::CURVE)?;
        let points = parse(&text).map_err(|e| Error::Input(format!("{}:{e}", path.display())))?;
        Ok(Self { points: points.into(), text: Some(text.into()) })
    }

    /// The file's text; `None` for the model that is built in.
    pub fn text(&self) -> Option<&str> {
        self.text.as_deref()
    }

    /// The threshold at a frequency, m RMS.
    pub fn threshold_m(&self, hz: f64) -> f64 {
        let above = self.points.partition_point(|[at_hz, _]| *at_hz <= hz);
        match (
            above.checked_sub(1).and_then(|below| self.points.get(below)),
            self.points.get(above),
        ) {
            (Some([low_hz, low_m]), Some([high_hz, high_m])) => {
                let share = libm::log(hz / low_hz) / libm::log(high_hz / low_hz);
                low_m * libm::exp(share * libm::log(high_m / low_m))
            }
            (Some([_, m]), None) | (None, Some([_, m])) => *m,
            (None, None) => f64::INFINITY,
        }
    }
}

/// The points of a curve, or the line and what is wrong with it.
fn parse(text: &str) -> Result<Vec<[f64; 2]>, String> {
    let mut points: Vec<[f64; 2]> = vec![];
    let mut lines = text.lines().zip(1..).filter(|(line, _)| {
        let line = line.trim();
        !line.is_empty() && !line.starts_with('#')
    });
    let header = lines.next().map_or("", |(line, _)| line.trim());
    if header != HEADER {
        return Err(format!("1: the first line is `{header:.40}`, allowed `{HEADER}`"));
    }
    for (line, number) in lines {
        let values: Vec<f64> = line.split(',').map_while(|cell| cell.trim().parse().ok()).collect();
        let wrong = |what: &str| format!("{number}: `{:.40}`: {what}", line.trim());
        let [hz, threshold_m] = values[..] else {
            return Err(wrong("allowed two numbers, Hz and m RMS"));
        };
        if !((1e-3..=1e6).contains(&hz) && (1e-12..=1.0).contains(&threshold_m)) {
            return Err(wrong("allowed 0.001 to 1e6 Hz and 1e-12 to 1 m"));
        }
        if points.last().is_some_and(|[last_hz, _]| *last_hz >= hz) {
            return Err(wrong("frequencies must rise"));
        }
        points.push([hz, threshold_m]);
    }
    if points.is_empty() || points.len() > 10_000 {
        return Err(format!("1: {} points, allowed 1 to 10000", points.len()));
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_is_what_its_page_says() {
        let model = FeltCurve::default();
        let near = |hz: f64, expected: f64| {
            let found = model.threshold_m(hz);
            assert!((found / expected - 1.0).abs() < 1e-12, "{hz} {found:e}");
        };
        near(500.0, 0.05e-6);
        near(180.0, 0.05e-6);
        near(90.0, 0.2e-6); // 12 dB an octave: a factor of 4
        near(21.0, 0.05e-6 * (180.0f64 / 21.0).powi(2));
        near(19.0, 4.05e-6);
        near(5.0, 4.05e-6);
    }

    #[test]
    fn what_is_no_curve_is_refused_with_its_line() {
        let refused = |rows: &str| parse(&format!("# x\n{HEADER}\n{rows}")).unwrap_err();
        assert_eq!(refused("10,1e-6\n10,1e-6"), "4: `10,1e-6`: frequencies must rise");
        assert!(refused("10").starts_with("3: `10`: allowed two numbers"));
        assert!(refused("10,x").contains("allowed two numbers"));
        assert!(refused("10,1e-6,3").contains("allowed two numbers"));
        assert!(refused("0,1e-6").contains("allowed 0.001"));
        assert!(refused("10,0").contains("allowed 0.001"));
        assert!(refused("").contains("0 points"));
        assert!(parse("a,b\n1,2").unwrap_err().contains("allowed `frequency_hz"));
    }
}
