//! Output of `design`: tables for programs, a table for people, a figure, a scene.

use std::fmt::Write as _;

use serde::Serialize;
use sim_studies::table::Cell;
use zwidth::{device::designs::DESIGNS_MAX, velocity::Biquad};

use super::{
    Cells, area_cells, csv_of,
    figure::{Figure, FigureError, Mark, TradePanel, TradePlot, TradeSeries, scaled_unit, trade},
    limits::{area_text, areas_in, walked_area},
    version,
};
use crate::{
    analysis::{
        compare::with_filter,
        design::{
            DesignStudy, Designed, MISTUNED_BY, Tried,
            shape::{Second, Shape},
        },
    },
    scene::{Scene, Units, VelocityTable},
    study::boundary::Boundaries,
};

/// Coefficients of a section in the core. Its DC gain is 1, and its denominator is `1 + a1 z^-1 + a2 z^-2`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SectionRow {
    b: [f64; 3],
    a: [f64; 2],
}

/// The table `[sweep]` of a scene.
#[derive(Clone, Debug, Serialize)]
pub struct SweepKeys {
    cutoffs_hz: [f64; 1],
}

#[derive(Clone, Debug, Serialize)]
pub struct FilterRow {
    /// Mean area in the worst condition.
    area_n2_s_per_m2: f64,
    area_low_n2_s_per_m2: f64,
    area_high_n2_s_per_m2: f64,
    /// Mean area divided by the area of a Butterworth low-pass in the same condition. The low-pass has its best cutoff.
    times_butterworth: f64,
    worst_condition: String,
    gain_peak_db: f64,
    /// Delay of the velocity for slow motion, in s. It is negative if the velocity leads.
    delay_s: f64,
    roughness_n: Option<f64>,
    mistuned_share: f64,
    capped_walks: usize,
    #[serde(flatten)]
    first: SectionRow,
    /// The coefficients of both sections, if the filter has two.
    #[serde(skip_serializing_if = "Option::is_none")]
    sections: Option<Vec<SectionRow>>,
    velocity: VelocityTable,
    sweep: SweepKeys,
}

/// The area of a filter, or of the Butterworth low-pass, in one condition.
#[derive(Clone, Debug, Serialize)]
pub struct ConditionRow {
    condition: String,
    /// Rank of the filter, starting with 1. `null` for the Butterworth low-pass.
    filter: Option<usize>,
    /// Cutoff of the Butterworth low-pass in Hz.
    cutoff_hz: Option<f64>,
    area_n2_s_per_m2: f64,
    area_low_n2_s_per_m2: f64,
    area_high_n2_s_per_m2: f64,
    times_butterworth: f64,
    stiffness_peak_n_per_m: f64,
    damping_max_n_s_per_m: f64,
    capped_walks: usize,
}

fn as_run(biquad: &Biquad) -> SectionRow {
    let one = f64::from(1 << Biquad::FRACTION_BITS);
    let [b0, b1, b2, a1, a2] = biquad.bits().map(|bits| f64::from(bits) / one);
    SectionRow { b: [b0, b1, b2], a: [a1, a2] }
}

/// The numbers that describe a shape, one list for each section. The second list is empty if there is one section.
fn shape_cells(shape: &Shape) -> [Cells; 2] {
    let &Shape { frequency_hz, damping, lead_s, zero, second } = shape;
    let first: [(&str, f64); 4] =
        [("frequency_hz", frequency_hz), ("damping", damping), ("lead_s", lead_s), ("zero", zero)];
    let second = second.map(|Second { ratio, damping, lead_s, zero }| {
        [
            ("second_ratio", ratio),
            ("second_damping", damping),
            ("second_lead_s", lead_s),
            ("second_zero", zero),
        ]
    });
    let cells = |numbers: [(&'static str, f64); 4]| {
        numbers.into_iter().map(|(name, number)| (name, number.into())).collect()
    };
    [cells(first), second.map_or(vec![], cells)]
}

fn section_cells(names: [&'static str; 5], SectionRow { b, a }: &SectionRow) -> Cells {
    let numbers = [b[0], b[1], b[2], a[0], a[1]];
    names.into_iter().zip(numbers.map(Cell::Number)).collect()
}

/// Name that the best filter gets in the written scene.
const BEST: &str = "best";

/// The scene with the best filter as its estimator, as the text of a file.
///
/// # Errors
/// The scene cannot be written as TOML.
pub fn best_scene(scene: &Scene, study: &Designs) -> Result<String, String> {
    let Some(best) = study.0.filters.first() else { return Err("there is no filter".into()) };
    let settings = best.shape.settings();
    let mut scene = with_filter(scene, &settings);
    scene.sweep.cutoffs_hz = vec![best.shape.frequency_hz];
    // if a design of the scene already has this filter, the design keeps its name
    scene.designs.remove(BEST);
    let known = scene.designs.values().any(|design| design.settings() == Some(settings));
    if !known && scene.designs.len() < DESIGNS_MAX {
        scene.designs.insert(BEST.into(), settings.into());
    }
    let tables = toml::to_string(&scene).map_err(|error| error.to_string())?;
    Ok(format!("# The filter is of `cargo sim design`: {}.\n\n{tables}", study.describe(best)))
}

#[derive(Clone, Debug)]
pub struct Designs(pub DesignStudy);

impl Designs {
    fn row(&self, filter: &Designed) -> FilterRow {
        let shape = &filter.shape;
        let boundaries = &filter.boundaries[filter.worst];
        let [area_low_n2_s_per_m2, area_high_n2_s_per_m2] = boundaries.area_range();
        let sections: Vec<SectionRow> = filter.sections.iter().map(as_run).collect();
        FilterRow {
            area_n2_s_per_m2: filter.area(),
            area_low_n2_s_per_m2,
            area_high_n2_s_per_m2,
            times_butterworth: filter.worth,
            worst_condition: self.0.question.conditions[filter.worst].name.clone(),
            gain_peak_db: filter.gain_peak_db,
            delay_s: -shape.led_s(),
            roughness_n: filter.roughness_n,
            mistuned_share: filter.mistuned_share,
            capped_walks: boundaries.capped(),
            first: sections[0],
            sections: (sections.len() > 1).then_some(sections),
            velocity: VelocityTable::from(shape.settings()).with_cutoff(None),
            sweep: SweepKeys { cutoffs_hz: [shape.frequency_hz] },
        }
    }

    /// All filters, the best first.
    pub fn rows(&self) -> Vec<FilterRow> {
        self.0.filters.iter().map(|filter| self.row(filter)).collect()
    }

    /// The Butterworth low-pass and all filters in every condition.
    pub fn condition_rows(&self) -> Vec<ConditionRow> {
        let of = |n: usize, filter: Option<usize>, boundaries: &Boundaries| {
            let reference = &self.0.references[n];
            let [area_low_n2_s_per_m2, area_high_n2_s_per_m2] = boundaries.area_range();
            ConditionRow {
                condition: self.0.question.conditions[n].name.clone(),
                filter: filter.map(|place| place + 1),
                cutoff_hz: filter.is_none().then_some(reference.cutoff_hz),
                area_n2_s_per_m2: boundaries.area(),
                area_low_n2_s_per_m2,
                area_high_n2_s_per_m2,
                times_butterworth: boundaries.area() / reference.boundaries.area(),
                stiffness_peak_n_per_m: boundaries.stiffness_peak_n_per_m(),
                damping_max_n_s_per_m: boundaries.damping_max_n_s_per_m(),
                capped_walks: boundaries.capped(),
            }
        };
        let in_condition = |n: usize| {
            let filters = self.0.filters.iter().enumerate();
            let filters = filters.map(move |(place, filter)| (Some(place), &filter.boundaries[n]));
            std::iter::once((None, &self.0.references[n].boundaries))
                .chain(filters)
                .map(move |(filter, boundaries)| of(n, filter, boundaries))
        };
        (0..self.0.question.conditions.len()).flat_map(in_condition).collect()
    }

    pub fn csv(&self) -> String {
        csv_of(self.0.filters.iter().zip(self.rows()).map(|(filter, row)| {
            let [mut cells, second] = shape_cells(&filter.shape);
            cells.extend(area_cells(&filter.boundaries[filter.worst]));
            cells.extend([
                ("times_butterworth", row.times_butterworth.into()),
                ("worst_condition", Cell::Quoted(row.worst_condition.into())),
                ("gain_peak_db", row.gain_peak_db.into()),
                ("delay_s", row.delay_s.into()),
                ("roughness_n", Cell::number(row.roughness_n)),
                ("mistuned_share", row.mistuned_share.into()),
                ("capped_walks", Cell::count(row.capped_walks)),
            ]);
            cells.extend(section_cells(["b0", "b1", "b2", "a1", "a2"], &row.first));
            if let Some([_, section]) = row.sections.as_deref() {
                let names = ["second_b0", "second_b1", "second_b2", "second_a1", "second_a2"];
                cells.extend(second.into_iter().chain(section_cells(names, section)));
            }
            cells.push(version());
            cells
        }))
    }

    pub fn tried_csv(&self) -> String {
        csv_of(self.0.tried.iter().map(|Tried { shape, gain_peak_db, worth }| {
            let more = [
                ("gain_peak_db", (*gain_peak_db).into()),
                ("times_butterworth_on_search_grid", (*worth).into()),
            ];
            shape_cells(shape).into_iter().flatten().chain(more).collect()
        }))
    }

    pub fn conditions_csv(&self) -> String {
        csv_of(self.condition_rows().into_iter().map(|row| {
            let filter = row.filter.map_or("butterworth".into(), Cell::count);
            vec![
                ("condition", Cell::Quoted(row.condition.into())),
                ("filter", filter),
                ("cutoff_hz", Cell::number(row.cutoff_hz)),
                ("area_n2_s_per_m2", row.area_n2_s_per_m2.into()),
                ("area_low_n2_s_per_m2", row.area_low_n2_s_per_m2.into()),
                ("area_high_n2_s_per_m2", row.area_high_n2_s_per_m2.into()),
                ("times_butterworth", row.times_butterworth.into()),
                ("stiffness_peak_n_per_m", row.stiffness_peak_n_per_m.into()),
                ("damping_max_n_s_per_m", row.damping_max_n_s_per_m.into()),
                ("capped_walks", Cell::count(row.capped_walks)),
            ]
        }))
    }

    /// The units of the scene. All conditions have the same device.
    fn units(&self) -> Units {
        self.0.question.conditions[0].scene.units
    }

    fn describe(&self, filter: &Designed) -> String {
        format!(
            "area {}, {:.2} times the best Butterworth filter's, gain peak {:.1} dB, in the worst of: {}",
            self.units().said(filter.area(), "N^2 s/m^2"),
            filter.worth,
            filter.gain_peak_db,
            self.0
                .question
                .conditions
                .iter()
                .map(|c| c.name.as_str())
                .collect::<Vec<_>>()
                .join("; ")
        )
    }

    /// Notes that a reader needs in order to understand the numbers.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec![];
        let capped: usize =
            self.0.filters.iter().flat_map(|f| &f.boundaries).map(|b| b.capped()).sum();
        if capped > 0 {
            notes.push(format!("caps of [walk] cut {capped} walks: the true areas are larger"));
        }
        if self.0.filters.iter().any(|filter| filter.roughness_n.is_none()) {
            notes.push(
                "a filter without roughness (-): the wall is not stable from every start".into(),
            );
        }
        notes
    }

    pub fn text(&self) -> String {
        let conditions = &self.0.question.conditions;
        let units = self.units();
        let (area_unit, _) = areas_in(units);
        let mut text = format!(
            "the best of {} tried filters, by area in the worst of {} condition{}\n  areas in {area_unit}, walks for each: \
             {}; x butter.: area divided by that of the best Butterworth filter",
            self.0.tried.len(),
            conditions.len(),
            if conditions.len() == 1 { "" } else { "s" },
            self.0.question.repeats
        );
        text += "\n         area    x butter. peak dB  lead ms     rough mistuned      f Hz damping    lead_s    zero";
        for (place, filter) in self.0.filters.iter().enumerate() {
            let shape = &filter.shape;
            let rough = filter.roughness_n.map_or("-".into(), |n| units.said(n, "N"));
            let _ = write!(
                text,
                "\n  {:>2} {:>8} {:>12.2} {:>7.1} {:>8.3} {:>9} {:>6.0} %  {:>8} {:>7} {:>9} {:>7}",
                place + 1,
                area_text(filter.area(), units),
                filter.worth,
                filter.gain_peak_db,
                1e3 * shape.led_s(),
                rough,
                100.0 * filter.mistuned_share,
                shape.frequency_hz,
                shape.damping,
                shape.lead_s,
                shape.zero
            );
        }
        let rough = self.0.reference_roughness_n.map_or("-".into(), |n| units.said(n, "N"));
        let _ = write!(
            text,
            "\n  peak: largest ratio of estimated to true velocity; lead: of the velocity of a slow motion, negative if it is \
             late\n  rough: RMS of the force above 100 Hz at K = {}, B = {} in the first condition; butterworth \
             {rough}\n  mistuned: area that is left in the worst case if frequency or damping is off by a factor of {MISTUNED_BY}",
            units.said(self.0.wall.stiffness_n_per_m, "N/m"),
            units.said(self.0.wall.damping_n_s_per_m, "N s/m")
        );
        for (n, condition) in conditions.iter().enumerate() {
            let reference = &self.0.references[n];
            let _ = write!(
                text,
                "\n  {}: butterworth {} at {} Hz; filters",
                condition.name,
                area_text(reference.boundaries.area(), units),
                reference.cutoff_hz
            );
            for filter in &self.0.filters {
                let boundaries = &filter.boundaries[n];
                let _ = write!(text, " {}", walked_area(boundaries, units));
            }
        }
        if let Some(best) = self.0.filters.first() {
            let shape = &best.shape;
            let _ = write!(
                text,
                "\n  the best one in a scene:\n    [velocity]\n    estimator = \"{}\"\n    damping = {}\n    \
                 lead_s = {}\n    zero = {}",
                shape.settings().name().text(),
                shape.damping,
                shape.lead_s,
                shape.zero
            );
            if let Some(Second { ratio, damping, lead_s, zero }) = shape.second {
                let _ = write!(
                    text,
                    "\n    second_ratio = {ratio}\n    second_damping = {damping}\n    \
                     second_lead_s = {lead_s}\n    second_zero = {zero}"
                );
            }
            let _ = write!(text, "\n    [sweep]\n    cutoffs_hz = [{}]", shape.frequency_hz);
        }
        for note in self.notes() {
            let _ = write!(text, "\n  note: {note}");
        }
        text
    }

    /// Three plots of the area. Their x axes are the gain peak, the roughness, and the loss of a mistuned filter.
    pub fn figure(&self, scene: &str) -> Result<Figure, FigureError> {
        type Value = fn(&Designed) -> f64;
        let (of_force, force_factor) = self.units().written("N");
        let (of_area, area_factor) = self.units().written("N² s/m²");
        let areas = self.0.filters.iter().map(|filter| area_factor * filter.area());
        let (power, of_area) = scaled_unit(areas.fold(0.0, f64::max), of_area);
        let force = format!("force above 100 Hz, m{of_force}");
        // Name of the axis, its lowest value, what a value is multiplied by.
        let values: [(&str, f64, f64, Value); 4] = [
            ("gain peak, dB", 0.1, 1.0, |filter| filter.gain_peak_db),
            (&force, force_factor, 1e3 * force_factor, |filter| {
                filter.roughness_n.unwrap_or(f64::INFINITY)
            }),
            ("area lost when mistuned, %", 0.1, 100.0, |filter| 1.0 - filter.mistuned_share),
            ("1 ms + delay, ms", 0.001, 1e3, |filter| 1e-3 - filter.shape.led_s()),
        ];
        let series = self.0.filters.iter().enumerate().map(|(place, filter)| TradeSeries {
            name: format!("{}: {:.1} dB", place + 1, filter.gain_peak_db),
            colour: place,
            mark: Mark::Circle,
            points: values
                .iter()
                .map(|(_, _, times, value)| {
                    vec![[area_factor * filter.area() / power, times * value(filter)]]
                })
                .collect(),
        });
        trade(&TradePlot {
            title: format!("Designed filters, {scene}"),
            subtitle: "the best below each gain peak; lower is better in every panel".into(),
            legend: "Filter".into(),
            x_title: format!("area, {of_area}"),
            panels: values
                .iter()
                .map(|(name, floor, ..)| TradePanel::new("", *name, *floor))
                .collect(),
            series: series.collect(),
            lines: false,
        })
    }
}
