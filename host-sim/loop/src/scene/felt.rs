//! The least motion that a hand feels at each frequency: a threshold curve from a small file.
//!
//! The built-in curve is a model (sources: `host-sim/data/felt-model.csv`). `wall_hit.felt_curve` names another curve.

use std::{ops::RangeInclusive, path::Path, sync::Arc};

use crate::{
    error::Error,
    input::{self, table::Table},
};

/// The curve of scenes that do not name a curve.
const MODEL: &str = include_str!("../../../data/felt-model.csv");
const COLUMNS: [(&str, RangeInclusive<f64>); 2] =
    [("frequency_hz", 1e-3..=1e6), ("threshold_rms_m", 1e-12..=1.0)];

/// The threshold as a function of frequency. Between the points, the curve is a straight line in log-log. Beyond the
/// ends it is constant.
#[derive(Clone, Debug, PartialEq)]
pub struct FeltCurve {
    /// Frequency in Hz, and threshold in m RMS, of each point. Frequencies increase.
    points: Arc<[[f64; 2]]>,
    text: Option<Arc<str>>,
}

impl Default for FeltCurve {
    fn default() -> Self {
        Self { points: parse(MODEL).unwrap_or_default().into(), text: None }
    }
}

impl FeltCurve {
    pub fn load(path: &Path) -> Result<Self, Error> {
        let text = input::read_text(path, input::CURVE)?;
        let points = parse(&text).map_err(|e| Error::Input(e).of(&path.display().to_string()))?;
        Ok(Self { points: points.into(), text: Some(text.into()) })
    }

    /// The file's text, or `None` for the built-in model.
    pub fn text(&self) -> Option<&str> {
        self.text.as_deref()
    }

    /// The threshold at a frequency, in m RMS.
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

/// Reads the points of a curve. An error is a message that names the wrong line.
fn parse(text: &str) -> Result<Vec<[f64; 2]>, String> {
    let table = Table::new(text)?;
    let rows = table.numbers(&COLUMNS)?;
    if table.header().len() > COLUMNS.len() {
        let (line, header) = (table.line(), table.header().join(","));
        return Err(format!("line {line}: columns {header}, allowed frequency_hz,threshold_rms_m"));
    }
    if let Some([(_, [last, _]), (line, [hz, _])]) =
        rows.array_windows().find(|[(_, last), (_, next)]| last[0] >= next[0])
    {
        return Err(format!(
            "line {line}: frequency_hz is {hz}, allowed above {last}: it must rise"
        ));
    }
    if rows.is_empty() || rows.len() > 10_000 {
        return Err(format!("{} points, allowed 1 to 10000", rows.len()));
    }
    Ok(rows.into_iter().map(|(_, point)| point).collect())
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
        near(90.0, 0.2e-6); // 12 dB per octave: a factor of 4
        near(21.0, 0.05e-6 * (180.0f64 / 21.0).powi(2));
        near(19.0, 4.05e-6);
        near(5.0, 4.05e-6);
    }

    #[test]
    fn what_is_no_curve_is_refused_with_its_line() {
        let refused =
            |rows: &str| parse(&format!("# x\nfrequency_hz,threshold_rms_m\n{rows}")).unwrap_err();
        let falls = "line 4: frequency_hz is 10, allowed above 10: it must rise";
        assert_eq!(refused("10,1e-6\n10,1e-6"), falls);
        let least = "line 3: frequency_hz is `0`, allowed 0.001 to 1000000";
        assert_eq!(refused("0,1e-6"), least);
        assert!(refused("10,0").contains("threshold_rms_m is `0`, allowed 0.000000000001 to 1"));
        assert!(refused("").contains("0 points"));
        let text = "frequency_hz,threshold_rms_m,x\n10,1e-6,3";
        assert!(parse(text).unwrap_err().starts_with("line 1: columns frequency_hz,"));
    }
}
