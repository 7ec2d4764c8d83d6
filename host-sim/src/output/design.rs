//! What `design` writes: tables for programs, one for people, one picture, a scene.

use std::fmt::Write as _;

use serde::Serialize;
use zwidth::{device::designs::DESIGNS_MAX, velocity::Biquad};

use super::{
    SCHEMA_VERSION,
    figure::{Figure, FigureError, Mark, TradePanel, TradePlot, TradeSeries, trade},
    limits::millions,
};
use crate::{
    analysis::{
        compare::with_filter,
        design::{
            DesignStudy, Designed, MISTUNED_BY, Tried,
            shape::{Second, Shape},
        },
    },
    scene::Scene,
    study::boundary::Boundaries,
};

/// `[velocity]` of a scene.
#[derive(Clone, Debug, Serialize)]
pub struct VelocityKeys {
    estimator: &'static str,
    damping: f64,
    lead_s: f64,
    zero: f64,
    #[serde(flatten)]
    second: Option<SecondKeys>,
}

/// Keys of a second section.
#[derive(Clone, Debug, Serialize)]
struct SecondKeys {
    second_ratio: f64,
    second_damping: f64,
    second_lead_s: f64,
    second_zero: f64,
}

impl VelocityKeys {
    fn of(shape: &Shape) -> Self {
        let Shape { damping, lead_s, zero, second, .. } = *shape;
        let estimator = shape.settings().name().text();
        let second = second.map(|second| SecondKeys {
            second_ratio: second.ratio,
            second_damping: second.damping,
            second_lead_s: second.lead_s,
            second_zero: second.zero,
        });
        Self { estimator, damping, lead_s, zero, second }
    }
}

/// A section as the core runs it: a DC gain of one, `1 + a1 z^-1 + a2 z^-2` below.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SectionRow {
    b: [f64; 3],
    a: [f64; 2],
}

/// `[sweep]` of a scene.
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
    /// Mean area over that of a Butterworth low-pass at its best cutoff there.
    times_butterworth: f64,
    worst_condition: String,
    gain_peak_db: f64,
    /// Delay of a slow motion's velocity; negative: the velocity is ahead.
    delay_s: f64,
    roughness_n: Option<f64>,
    mistuned_share: f64,
    capped_walks: usize,
    #[serde(flatten)]
    first: SectionRow,
    /// Both sections, where there are two.
    #[serde(skip_serializing_if = "Option::is_none")]
    sections: Option<Vec<SectionRow>>,
    velocity: VelocityKeys,
    sweep: SweepKeys,
}

/// A filter, or Butterworth, in a condition.
#[derive(Clone, Debug, Serialize)]
pub struct ConditionRow {
    condition: String,
    /// Place of the filter, from 1; `null` for Butterworth.
    filter: Option<usize>,
    /// Cutoff of Butterworth's poles, Hz.
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

fn optional(value: Option<f64>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// Name of the best filter in its scene.
const BEST: &str = "best";

/// The scene with the best filter, as a file.
///
/// # Errors
/// It cannot be written as TOML.
pub fn best_scene(scene: &Scene, study: &Designs) -> Result<String, String> {
    let Some(best) = study.0.filters.first() else { return Err("there is no filter".into()) };
    let settings = best.shape.settings();
    let mut scene = with_filter(scene, &settings);
    scene.sweep.cutoffs_hz = vec![best.shape.frequency_hz];
    // One that stands there already has its name.
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
            velocity: VelocityKeys::of(shape),
            sweep: SweepKeys { cutoffs_hz: [shape.frequency_hz] },
        }
    }

    /// Every filter, best first.
    pub fn rows(&self) -> Vec<FilterRow> {
        self.0.filters.iter().map(|filter| self.row(filter)).collect()
    }

    /// Butterworth and every filter in every condition.
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
        let mut text = String::from(
            "frequency_hz,damping,lead_s,zero,area_n2_s_per_m2,area_low_n2_s_per_m2,area_high_n2_s_per_m2,\
             times_butterworth,worst_condition,gain_peak_db,delay_s,roughness_n,mistuned_share,capped_walks,\
             b0,b1,b2,a1,a2,",
        );
        if self.0.question.sections > 1 {
            text += "second_ratio,second_damping,second_lead_s,second_zero,";
            text += "second_b0,second_b1,second_b2,second_a1,second_a2,";
        }
        text += "schema_version\n";
        for (filter, row) in self.0.filters.iter().zip(self.rows()) {
            let shape = &filter.shape;
            let numbers = |SectionRow { b, a }: &SectionRow| [b[0], b[1], b[2], a[0], a[1]];
            let mut rest = numbers(&row.first).to_vec();
            if let (Some(second), Some([_, section])) = (shape.second, row.sections.as_deref()) {
                rest.extend([second.ratio, second.damping, second.lead_s, second.zero]);
                rest.extend(numbers(section));
            }
            let rest: Vec<String> = rest.iter().map(f64::to_string).collect();
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{},{},\"{}\",{},{},{},{},{},{},{SCHEMA_VERSION}",
                shape.frequency_hz,
                shape.damping,
                shape.lead_s,
                shape.zero,
                row.area_n2_s_per_m2,
                row.area_low_n2_s_per_m2,
                row.area_high_n2_s_per_m2,
                row.times_butterworth,
                row.worst_condition,
                row.gain_peak_db,
                row.delay_s,
                optional(row.roughness_n),
                row.mistuned_share,
                row.capped_walks,
                rest.join(",")
            );
        }
        text
    }

    pub fn tried_csv(&self) -> String {
        let mut text = String::from("frequency_hz,damping,lead_s,zero,");
        if self.0.question.sections > 1 {
            text += "second_ratio,second_damping,second_lead_s,second_zero,";
        }
        text += "gain_peak_db,times_butterworth_on_search_grid\n";
        for Tried { shape, gain_peak_db, worth } in &self.0.tried {
            let (f, d, l, z) = (shape.frequency_hz, shape.damping, shape.lead_s, shape.zero);
            let _ = write!(text, "{f},{d},{l},{z},");
            if let Some(Second { ratio, damping, lead_s, zero }) = shape.second {
                let _ = write!(text, "{ratio},{damping},{lead_s},{zero},");
            }
            let _ = writeln!(text, "{gain_peak_db},{worth}");
        }
        text
    }

    pub fn conditions_csv(&self) -> String {
        let mut text = String::from(
            "condition,filter,cutoff_hz,area_n2_s_per_m2,area_low_n2_s_per_m2,area_high_n2_s_per_m2,\
             times_butterworth,stiffness_peak_n_per_m,damping_max_n_s_per_m,capped_walks\n",
        );
        for row in self.condition_rows() {
            let _ = writeln!(
                text,
                "\"{}\",{},{},{},{},{},{},{},{},{}",
                row.condition,
                row.filter.map_or("butterworth".into(), |place| place.to_string()),
                optional(row.cutoff_hz),
                row.area_n2_s_per_m2,
                row.area_low_n2_s_per_m2,
                row.area_high_n2_s_per_m2,
                row.times_butterworth,
                row.stiffness_peak_n_per_m,
                row.damping_max_n_s_per_m,
                row.capped_walks
            );
        }
        text
    }

    fn describe(&self, filter: &Designed) -> String {
        format!(
            "{} N^2 s/m^2 x 10^6, {:.2} times Butterworth's best, gain peak {:.1} dB, in the worst of: {}",
            millions(filter.area()),
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

    /// What a reader must know beside the numbers.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec![];
        let capped: usize =
            self.0.filters.iter().flat_map(|f| &f.boundaries).map(|b| b.capped()).sum();
        if capped > 0 {
            notes.push(format!(
                "{capped} walks are cut at a cap of [walk]: their areas are larger than stated"
            ));
        }
        if self.0.filters.iter().any(|filter| filter.roughness_n.is_none()) {
            notes.push(
                "no roughness: the wall is not stable with that filter from every start".into(),
            );
        }
        notes
    }

    pub fn text(&self) -> String {
        let conditions = &self.0.question.conditions;
        let mut text = format!(
            "filters by area in the worst of {} condition{}, {} walked; areas in 10^6 N^2 s/m^2, {} walks each",
            conditions.len(),
            if conditions.len() == 1 { "" } else { "s" },
            self.0.tried.len(),
            self.0.question.repeats
        );
        let _ = write!(
            text,
            "\n     {:>8} {:>12} {:>7} {:>8} {:>9} {:>8}  {:>8} {:>7} {:>9} {:>7}",
            "area",
            "butterworth x",
            "peak dB",
            "lead ms",
            "rough mN",
            "mistuned",
            "f Hz",
            "damping",
            "lead_s",
            "zero"
        );
        for (place, filter) in self.0.filters.iter().enumerate() {
            let shape = &filter.shape;
            let rough = filter.roughness_n.map_or("-".into(), |n| format!("{:.0}", 1e3 * n));
            let _ = write!(
                text,
                "\n  {:>2} {:>8} {:>12.2} {:>7.1} {:>8.3} {:>9} {:>6.0} %  {:>8} {:>7} {:>9} {:>7}",
                place + 1,
                millions(filter.area()),
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
        let rough =
            self.0.reference_roughness_n.map_or("-".into(), |n| format!("{:.0} mN", 1e3 * n));
        let _ = write!(
            text,
            "\n  rough: force above 100 Hz at K = {:.0} N/m, B = {} N s/m in the first condition; butterworth {rough}\n  \
             mistuned: area left with frequency or damping off by {MISTUNED_BY}, the worst way",
            self.0.wall.stiffness_n_per_m, self.0.wall.damping_n_s_per_m
        );
        for (n, condition) in conditions.iter().enumerate() {
            let reference = &self.0.references[n];
            let _ = write!(
                text,
                "\n  {}: butterworth {} at {} Hz; filters",
                condition.name,
                millions(reference.boundaries.area()),
                reference.cutoff_hz
            );
            for filter in &self.0.filters {
                let boundaries = &filter.boundaries[n];
                let cut = if boundaries.capped() > 0 { ">" } else { "" };
                let _ = write!(text, " {cut}{}", millions(boundaries.area()));
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

    /// Area against gain peak, roughness, and what a mistuned filter loses.
    ///
    /// # Errors
    /// A number cannot be drawn.
    pub fn figure(&self, scene: &str) -> Result<Figure, FigureError> {
        type Value = fn(&Designed) -> f64;
        let values: [(&str, f64, Value); 4] = [
            ("gain peak, dB", 0.1, |filter| filter.gain_peak_db),
            ("force above 100 Hz, mN", 1.0, |filter| {
                filter.roughness_n.map_or(f64::INFINITY, |n| 1e3 * n)
            }),
            ("area lost when mistuned, %", 0.1, |filter| 100.0 * (1.0 - filter.mistuned_share)),
            ("1 ms + delay, ms", 0.001, |filter| 1.0 - 1e3 * filter.shape.led_s()),
        ];
        let series = self.0.filters.iter().enumerate().map(|(place, filter)| TradeSeries {
            name: format!("{}: {:.1} dB", place + 1, filter.gain_peak_db),
            colour: place,
            mark: Mark::Circle,
            points: values
                .iter()
                .map(|(_, _, value)| vec![[filter.area() / 1e6, value(filter)]])
                .collect(),
        });
        trade(&TradePlot {
            title: format!("Designed filters, {scene}"),
            subtitle: "the best below each gain peak; lower is better in every panel".into(),
            legend: "Filter".into(),
            x_title: "area, 10\u{2076} N\u{b2} s/m\u{b2}".into(),
            panels: values
                .iter()
                .map(|(name, floor, _)| TradePanel {
                    title: String::new(),
                    y_title: (*name).into(),
                    limit: None,
                    floor: *floor,
                    front: vec![],
                })
                .collect(),
            series: series.collect(),
            lines: false,
        })
    }
}
