//! Output of `sweep --encoder-rates` and `--output-rates`: a table for programs, a table for people, a figure.

use std::fmt::Write as _;

use serde::Serialize;
use sim_studies::table::Cell;

use super::{
    figure::{Figure, FigureError, Mark},
    levers::{LeverStudy, actuator_cells, cell},
    limits::{areas_in, name_in},
};
use crate::{
    scene::Scene,
    study::levers::{Lever, LeverResult},
};

/// The result of one pair of rates with one limit and push, in `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct RateSummary {
    encoder_rate_hz: f64,
    output_rate_hz: f64,
    push: &'static str,
    limit: f64,
    limit_unit: &'static str,
    ideal_cutoff_hz: Option<f64>,
    ideal_cutoff_range_hz: Option<[f64; 2]>,
    area_at_ideal_n2_s_per_m2: f64,
    is_capped: bool,
    true_velocity_area_n2_s_per_m2: f64,
}

/// A study whose loops each have one pair of rates.
#[derive(Clone, Debug)]
pub struct RateStudy(pub LeverStudy);

/// Encoder rate and output rate of a scene, in Hz.
fn rates(scene: &Scene) -> [f64; 2] {
    let encoder_hz = scene.control.rate_hz;
    [encoder_hz, encoder_hz / f64::from(scene.actuator.period)]
}

/// The rates of all loops, sorted. Each rate is there once. `which` is 0 for the encoder rate and 1 for the output
/// rate.
fn axis(study: &LeverStudy, which: usize) -> Vec<f64> {
    let all: Vec<f64> =
        study.question.levers.iter().map(|lever| rates(&lever.scene)[which]).collect();
    crate::study::sweep::ascending(&all)
}

impl RateStudy {
    fn of(&self, result: &LeverResult) -> [f64; 2] {
        rates(&self.0.lever(result).scene)
    }

    pub fn csv(&self) -> String {
        self.0.table_of(|lever| {
            let [encoder, output] = rates(&lever.scene).map(Cell::Number);
            let rates = [("encoder_rate_hz", encoder), ("output_rate_hz", output)];
            rates.into_iter().chain(actuator_cells(&lever.scene)).collect()
        })
    }

    pub fn summary(&self) -> Vec<RateSummary> {
        let summary = |result: &LeverResult| {
            let [encoder_rate_hz, output_rate_hz] = self.of(result);
            let (limit, limit_unit) = result.limit.told();
            RateSummary {
                encoder_rate_hz,
                output_rate_hz,
                push: result.push.name(),
                limit,
                limit_unit,
                ideal_cutoff_hz: result.sweep.ideal.map(|ideal| ideal.cutoff_hz),
                ideal_cutoff_range_hz: result.sweep.ideal.map(|ideal| ideal.range_hz),
                area_at_ideal_n2_s_per_m2: result.area(),
                is_capped: result.best().is_some_and(|walked| walked.boundaries.capped() > 0),
                true_velocity_area_n2_s_per_m2: result.told.boundaries.area(),
            }
        };
        self.0.results.iter().map(summary).collect()
    }

    /// The tables for people, one for each limit and push.
    pub fn text(&self) -> String {
        let [encoder, output] = [0, 1].map(|which| axis(&self.0, which));
        let question = &self.0.question;
        let units = question.units();
        let mut text = format!(
            "encoder rate (rows) and output rate: area at the ideal cutoff, {}, with the ideal range in Hz; > cut at a cap",
            areas_in(units).0
        );
        let situations = question
            .limits
            .iter()
            .flat_map(|&limit| question.pushes.iter().map(move |&push| (limit, push)));
        for (limit, push) in situations {
            let _ = write!(
                text,
                "\n  limit {}, the {} pushes\n  {:>10}",
                name_in(limit, units),
                push.name(),
                "Hz"
            );
            for hz in &output {
                let _ = write!(text, "  {hz:>24}");
            }
            for &encoder in &encoder {
                let _ = write!(text, "\n  {encoder:>10}");
                for &output in &output {
                    let it = self.0.results.iter().find(|result| {
                        self.of(result) == [encoder, output]
                            && (result.limit, result.push) == (limit, push)
                    });
                    let _ =
                        write!(text, "  {:>24}", it.map_or(String::new(), |it| cell(it, units)));
                }
            }
        }
        text
    }

    pub const CAPTION: &str = "The area at the ideal cutoff where the same device looks and acts more or less often, the latency the same.";

    /// The figure. It shows the area at the ideal cutoff over the output rate. Each line belongs to an encoder rate,
    /// each panel to a limit. Only results with the motor's push are shown.
    pub fn figure(&self, scene: &str) -> Result<Option<Figure>, FigureError> {
        let Some(&push) = self.0.question.pushes.first() else { return Ok(None) };
        let line = |(n, encoder): (usize, f64)| {
            let x_of = |lever: &Lever| {
                let [of_encoder, output] = rates(&lever.scene);
                (of_encoder == encoder).then_some(output)
            };
            self.0.line(format!("{encoder} Hz"), (n, Mark::Circle), push, x_of)
        };
        let series = axis(&self.0, 0).into_iter().enumerate().map(line).collect();
        let texts = ["Encoder rate and output rate", "Encoder rate", "Output rate [Hz]"];
        self.0.panels(scene, texts, push, series)
    }
}
