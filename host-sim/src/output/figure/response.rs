//! The paper's figure 4. It shows voltage, measured and modelled position, and the difference of the two positions.

use plotters::prelude::*;

use crate::scene::Units;

use super::{
    Figure, FigureError, Page, WIDTH,
    axis::Ticks,
    colour::{ACCENT, DATA, TEXT},
    panel::{self, Grid, Panel, X_TITLE_DROP},
    plottable, positive,
    trace::{MM_PER_M, draw_trace, range, small_unit},
};

const VOLTAGE: Panel = Panel { left: 76.0, top: 58.0, right: WIDTH - 24.0, bottom: 118.0 };
const POSITION: Panel =
    Panel { top: VOLTAGE.bottom + 34.0, bottom: VOLTAGE.bottom + 224.0, ..VOLTAGE };
const RESIDUAL: Panel =
    Panel { top: POSITION.bottom + 22.0, bottom: POSITION.bottom + 112.0, ..VOLTAGE };
const HEIGHT: f64 = RESIDUAL.bottom + 50.0;
/// Space below a panel that has another panel below it.
const NO_TITLE_DROP: f64 = 4.0;
const MOST_X_TICKS: usize = 9;
const MOST_Y_TICKS: usize = 6;
const FEW_Y_TICKS: usize = 5;
/// Space above and below the pulses, as a fraction of their height.
const VOLTAGE_PAD: f64 = 0.15;

/// Width of the measured line. The measured line is wide and the modelled line is thin, so both lines are visible where
/// the positions agree.
const MEASURED_WIDTH: f64 = 3.2;
const MODEL_WIDTH: f64 = 1.1;
const RESIDUAL_WIDTH: f64 = 0.5;
const MEASURED_OPACITY: f64 = 0.45;
/// Height of the legend, above the position.
const LEGEND_MIDDLE: f64 = POSITION.top - 14.0;
const LEGEND_SAMPLE: f64 = 26.0;
const LEGEND_PITCH: f64 = 18.0;

/// Data of [`pulse_response`]. The time between rows is constant.
#[derive(Debug, Clone, PartialEq)]
pub struct ResponsePlot {
    pub title: String,
    /// The second line, which has the parameters.
    pub subtitle: String,
    pub start_s: f64,
    /// Time from one row to the next, in s.
    pub step_s: f64,
    /// Command at each row, and the title of its axis.
    pub command: Vec<f64>,
    pub command_title: &'static str,
    /// Measured position at each row, in m.
    pub measured_m: Vec<f64>,
    /// First row of the fit.
    pub first: usize,
    /// Modelled position from row `first` on, in m.
    pub model_m: Vec<f64>,
    /// Measured minus modelled position from row `first` on, in m.
    pub residual_m: Vec<f64>,
    pub units: Units,
}

/// Draws the response to a command, measured and modelled.
///
/// # Errors
/// [`FigureError`] if a number is NaN or infinite, the step is not greater than 0, or there are no samples.
pub fn pulse_response(plot: &ResponsePlot) -> Result<Figure, FigureError> {
    plottable("start_s", plot.start_s)?;
    positive("step_s", plot.step_s)?;
    if plot.measured_m.is_empty() || plot.model_m.is_empty() {
        return Err(FigureError::no_samples());
    }
    for (quantity, values) in [
        ("command", &plot.command),
        ("measured_m", &plot.measured_m),
        ("model_m", &plot.model_m),
        ("residual_m", &plot.residual_m),
    ] {
        for value in values {
            plottable(quantity, *value)?;
        }
    }
    Figure::new([&plot.title, &plot.subtitle], HEIGHT, &|page| draw(plot, page))
}

fn draw(plot: &ResponsePlot, page: &Page) -> Result<(), FigureError> {
    let end_s = plot.start_s + plot.step_s * plot.measured_m.len() as f64;
    let times = || Ticks::within(plot.start_s, end_s, MOST_X_TICKS);
    let time = |row: usize| plot.start_s + row as f64 * plot.step_s;

    let held = plot.command.iter().enumerate();
    let command = held.flat_map(|(row, is)| [(time(row), *is), (time(row + 1), *is)]);
    let [low, high] = range(plot.command.iter().copied());
    let pad = VOLTAGE_PAD * (high - low);
    let y = Ticks::within(low - pad, high + pad, FEW_Y_TICKS);
    let mut chart = VOLTAGE.chart(page, times().bare(), y, NO_TITLE_DROP)?;
    panel::axes(&mut chart, Grid::Horizontal, ["", plot.command_title])?;
    draw_trace(page, &chart, command, TEXT.mix(1.0), MODEL_WIDTH)?;
    VOLTAGE.frame(page)?;

    let told = MM_PER_M * plot.units.written("mm").1;
    let position_title = match plot.units.is_rotary() {
        true => "Angle [deg]",
        false => "Position x [mm]",
    };
    let all = plot.measured_m.iter().chain(&plot.model_m);
    let [low, high] = range(all.map(|position_m| position_m * told));
    let y = Ticks::around(low, high, MOST_Y_TICKS);
    let mut chart = POSITION.chart(page, times().bare(), y, NO_TITLE_DROP)?;
    panel::axes(&mut chart, Grid::Horizontal, ["", position_title])?;
    let scaled = |values: &[f64], first: usize, factor: f64| -> Vec<(f64, f64)> {
        let values = values.iter().enumerate();
        values.map(|(row, value)| (time(first + row), value * factor)).collect()
    };
    let measured = scaled(&plot.measured_m, 0, told);
    draw_trace(page, &chart, measured.into_iter(), DATA.mix(MEASURED_OPACITY), MEASURED_WIDTH)?;
    let model = scaled(&plot.model_m, plot.first, told);
    draw_trace(page, &chart, model.into_iter(), ACCENT.mix(1.0), MODEL_WIDTH)?;
    POSITION.frame(page)?;
    let lines = [
        ("measured", DATA.mix(MEASURED_OPACITY), MEASURED_WIDTH),
        ("model", ACCENT.mix(1.0), MODEL_WIDTH),
    ];
    let begin = [POSITION.left, LEGEND_MIDDLE];
    panel::legend(page, begin, [LEGEND_SAMPLE, LEGEND_PITCH], lines)?;

    let [low, high] = range(plot.residual_m.iter().copied());
    let (unit, factor) = small_unit([low, high]);
    let (unit, of_unit) = plot.units.written(unit);
    let factor = factor * of_unit;
    let y = Ticks::around(low * factor, high * factor, FEW_Y_TICKS);
    let mut chart = RESIDUAL.chart(page, times(), y, X_TITLE_DROP)?;
    panel::axes(&mut chart, Grid::Horizontal, ["Time t [s]", &format!("Residual [{unit}]")])?;
    let residual = scaled(&plot.residual_m, plot.first, factor);
    draw_trace(page, &chart, residual.into_iter(), DATA.mix(1.0), RESIDUAL_WIDTH)?;
    RESIDUAL.frame(page)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::figure::testing::{Pixels, check as look};

    fn plot() -> ResponsePlot {
        let rows = 20_000;
        let measured_m: Vec<f64> = (0..rows).map(|n| 0.02 * (f64::from(n) * 5e-4).sin()).collect();
        ResponsePlot {
            title: "Response to a voltage".to_owned(),
            subtitle: "m = 0.416 kg".to_owned(),
            start_s: 0.0,
            step_s: 1e-4,
            command_title: "u [V]",
            command: (0..rows).map(|n| if n < 2000 { 4.0 } else { 0.0 }).collect(),
            first: 10,
            model_m: measured_m[10..].iter().map(|x| x + 1e-6).collect(),
            residual_m: vec![-1e-6; 19_990],
            units: Units::Linear,
            measured_m,
        }
    }

    #[test]
    fn the_response_stays_small_and_labelled() {
        let figure = look(pulse_response, &plot());
        assert!(figure.svg().len() < 300_000);
        for text in ["u [V]", "Position x [mm]", "Residual [µm]", "Time t [s]", "measured", "model"]
        {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
        assert!(Pixels::of(&figure).count(ACCENT) > 500, "the model does not show");
    }

    #[test]
    fn a_model_that_is_far_off_is_seen() {
        let mut off = plot();
        off.residual_m = vec![-0.01; 19_990];
        assert!(look(pulse_response, &off).svg().contains("Residual [mm]"));
    }

    #[test]
    fn impossible_responses_are_errors() {
        let mut bad = plot();
        bad.model_m[3] = f64::NAN;
        assert_eq!(
            pulse_response(&bad),
            Err(FigureError::of("model_m", crate::output::figure::NOT_PLOTTABLE))
        );
        assert_eq!(
            pulse_response(&ResponsePlot { measured_m: vec![], ..plot() }),
            Err(FigureError::no_samples())
        );
    }
}
