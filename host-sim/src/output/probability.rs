//! Output of `sweep --probability`: maps, contours, the firmware's envelope, a figure, a table for people.

use std::fmt::Write as _;

use serde::Serialize;

use super::{
    SCHEMA_VERSION,
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
    limits::{area_text, areas_in},
};
use crate::{
    scene::{NamedScene, Units},
    study::{
        boundary::BoundaryPoint,
        envelope::{Envelope, Interval},
        probability::{
            DRAWS_MIN, Map, Verdicts, WORST,
            contour::{SHARE, Tried, contour},
        },
    },
};

/// Shares of the draws that have a contour: the walls that are stable in at least this share.
const SHARES: [f64; 3] = [0.05, 0.5, 0.95];

/// The confidence interval of the area in the worst 5 % of the draws, as text for people.
fn interval(c: &CutoffProbability, units: Units) -> String {
    let end = |end: Option<f64>| end.map_or_else(|| "?".to_owned(), |area| area_text(area, units));
    match [c.area_5_percent_low_n2_s_per_m2, c.area_5_percent_high_n2_s_per_m2] {
        [None, None] => String::new(),
        [low, high] => format!("{} to {}", end(low), end(high)),
    }
}

#[derive(Clone, Debug)]
pub struct ProbabilityStudy {
    /// One map per cutoff, in ascending order.
    pub maps: Vec<Map>,
    pub verdicts: Verdicts,
    /// The firmware's contour. It was tried at the cutoff whose area in the worst draws is largest.
    pub tried: Option<Tried>,
}

#[derive(Clone, Debug, Serialize)]
pub struct ProbabilitySummary {
    draws: u32,
    /// The cutoff whose area in the worst 5 % of the draws is largest. `null` if this area has no lower bound.
    recommended_cutoff_hz: Option<f64>,
    /// Cutoffs that the draws cannot distinguish from the recommended cutoff.
    alike_hz: Vec<f64>,
    cutoffs: Vec<CutoffProbability>,
    contour: Option<ContourSummary>,
}

#[derive(Clone, Debug, Serialize)]
struct CutoffProbability {
    cutoff_hz: f64,
    area_n2_s_per_m2: f64,
    area_5_percent_n2_s_per_m2: f64,
    /// 95 % confidence interval of the area in the worst 5 % of the draws. `null` if there are too few devices.
    area_5_percent_low_n2_s_per_m2: Option<f64>,
    area_5_percent_high_n2_s_per_m2: Option<f64>,
    area_50_percent_n2_s_per_m2: f64,
    area_95_percent_n2_s_per_m2: f64,
    best_share: f64,
    ideal_share: f64,
    undecided_share: f64,
    is_capped: bool,
}

#[derive(Clone, Debug, Serialize)]
struct ContourSummary {
    cutoff_hz: f64,
    length: f64,
    draws: u32,
    held: u32,
    share: f64,
    share_low: f64,
    share_high: f64,
}

impl ProbabilityStudy {
    pub const CAPTION: &str = "Walls at the cutoff that leads in the worst draws that 5, 50 and 95 % of the draws hold, and those of the \
                               firmware, fitted on fresh draws.";

    fn leading(&self) -> Option<&Map> {
        self.verdicts.leading.and_then(|place| self.maps.get(place))
    }

    /// The leading cutoff, as a recommendation. `None` if its confidence interval does not support a recommendation.
    fn recommended_hz(&self) -> Option<f64> {
        let is_borne = |map: &&Map| map.devices == 0 || map.interval(WORST)[0].is_some();
        self.leading().filter(is_borne).map(|map| map.cutoff_hz)
    }

    pub fn summary(&self) -> ProbabilitySummary {
        let contour = self.tried.as_ref().zip(self.leading()).map(|(tried, map)| {
            let [share, share_low, share_high] = tried.share();
            let cutoff_hz = map.cutoff_hz;
            let Tried { length, draws, held, .. } = *tried;
            ContourSummary { cutoff_hz, length, draws, held, share, share_low, share_high }
        });
        ProbabilitySummary {
            draws: self.maps.first().map_or(0, |map| map.trials),
            recommended_cutoff_hz: self.recommended_hz(),
            alike_hz: self.verdicts.alike.iter().map(|place| self.maps[*place].cutoff_hz).collect(),
            cutoffs: self.cutoffs(),
            contour,
        }
    }

    fn cutoffs(&self) -> Vec<CutoffProbability> {
        let counts = self.verdicts.best.iter().zip(&self.verdicts.ideal);
        let of = |(map, (best, ideal)): (&Map, (&u32, &u32))| {
            let share = |count: &u32| f64::from(*count) / f64::from(map.trials);
            let [low, high] = map.interval(WORST);
            CutoffProbability {
                cutoff_hz: map.cutoff_hz,
                area_n2_s_per_m2: map.area(),
                area_5_percent_n2_s_per_m2: map.quantile(WORST),
                area_5_percent_low_n2_s_per_m2: low,
                area_5_percent_high_n2_s_per_m2: high,
                area_50_percent_n2_s_per_m2: map.quantile(0.5),
                area_95_percent_n2_s_per_m2: map.quantile(1.0 - WORST),
                best_share: share(best),
                ideal_share: share(ideal),
                undecided_share: map.undecided_share(),
                is_capped: map.is_capped,
            }
        };
        self.maps.iter().zip(counts).map(of).collect()
    }

    pub fn csv(&self) -> String {
        let mut text = String::from(
            "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m,held,draws,share,schema_version\n",
        );
        for map in &self.maps {
            for (b, k) in (0..map.cells[1]).flat_map(|b| (0..map.cells[0]).map(move |k| (b, k))) {
                let [stiffness, damping] = map.wall([k, b]);
                let (held, trials) = (map.held([k, b]), map.trials);
                let _ = writeln!(
                    text,
                    "{},{damping},{stiffness},{held},{trials},{},{SCHEMA_VERSION}",
                    map.cutoff_hz,
                    f64::from(held) / f64::from(trials)
                );
            }
        }
        text
    }

    /// Text of `contours.csv`. The row of the firmware's contour has the share 95, and `fitted` is true.
    pub fn contours_csv(&self) -> String {
        let mut text = String::from(
            "cutoff_hz,percent,fitted,damping_n_s_per_m,stiffness_low_n_per_m,stiffness_high_n_per_m,\
             schema_version\n",
        );
        let mut rows = |cutoff_hz: f64, share: f64, fitted: bool, intervals: &[Interval]| {
            for Interval { damping_n_s_per_m: b, stiffness_low_n_per_m, stiffness_high_n_per_m } in
                intervals
            {
                let _ = writeln!(
                    text,
                    "{cutoff_hz},{},{fitted},{b},{stiffness_low_n_per_m},{stiffness_high_n_per_m},{SCHEMA_VERSION}",
                    100.0 * share
                );
            }
        };
        for map in &self.maps {
            for share in SHARES {
                rows(map.cutoff_hz, share, false, &contour(map, share));
            }
        }
        if let Some((tried, map)) = self.tried.as_ref().zip(self.leading()) {
            rows(map.cutoff_hz, SHARE, true, &tried.intervals);
        }
        text
    }

    /// The fitted contour at the leading cutoff, as the firmware needs it.
    pub fn envelope(&self) -> Vec<Envelope> {
        let tried = self.tried.as_ref().zip(self.leading());
        let of = |(tried, map): (&Tried, &Map)| Envelope {
            velocity: map.velocity,
            intervals: tried.intervals.clone(),
        };
        tried.map(of).into_iter().collect()
    }

    /// The contours at the leading cutoff.
    pub fn figure(&self, scene: &NamedScene) -> Result<Option<Figure>, FigureError> {
        let Some(map) = self.leading() else { return Ok(None) };
        let points = |intervals: &[Interval]| {
            let upper = intervals.iter().map(|interval| BoundaryPoint {
                damping_n_s_per_m: interval.damping_n_s_per_m,
                stiffness_n_per_m: interval.stiffness_high_n_per_m,
            });
            upper.collect()
        };
        let curve = |name: String, ideal, intervals: &[Interval]| Curve {
            detail: format!("{name}, {} Hz", map.cutoff_hz),
            name,
            ideal,
            points: points(intervals),
        };
        let mut curves: Vec<Curve> = SHARES
            .iter()
            .map(|&share| curve(format!("{} %", 100.0 * share), false, &contour(map, share)))
            .collect();
        if let Some(tried) = &self.tried {
            curves.push(curve("firmware".into(), true, &tried.intervals));
        }
        let title = format!("How sure a wall is, {}, {} Hz", scene.name, map.cutoff_hz);
        let subtitle = format!("largest K that a share of {} draws holds", map.trials);
        let legend = "Share".into();
        let units = scene.scene.units;
        zwidth(&ZwidthPlot { units, title, subtitle, legend, marked: "ideal", curves }).map(Some)
    }

    pub fn text(&self, units: Units) -> String {
        let summary = self.summary();
        let mut text = format!(
            "how sure: integral of the share of {} draws that hold, and areas of the draws, {}; > cut at a cap",
            summary.draws,
            areas_in(units).0
        );
        text += "\n  cutoff Hz   integral      5 %  95 % interval     50 %     95 %    best   ideal  undecided";
        for c in &summary.cutoffs {
            let cut = if c.is_capped { ">" } else { "" };
            let _ = write!(
                text,
                "\n  {:>9} {:>10} {:>8} {:>14} {:>8} {:>8} {:>5.0} % {:>5.0} % {:>8.0} %",
                c.cutoff_hz,
                format!("{cut}{}", area_text(c.area_n2_s_per_m2, units)),
                area_text(c.area_5_percent_n2_s_per_m2, units),
                interval(c, units),
                area_text(c.area_50_percent_n2_s_per_m2, units),
                area_text(c.area_95_percent_n2_s_per_m2, units),
                100.0 * c.best_share,
                100.0 * c.ideal_share,
                100.0 * c.undecided_share
            );
        }
        let alike: Vec<String> = summary.alike_hz.iter().map(f64::to_string).collect();
        let alike = alike.join(", ");
        let _ = match (summary.recommended_cutoff_hz, self.leading()) {
            (_, None) => write!(text, "\n  no wall holds"),
            (Some(hz), Some(map)) if map.devices == 0 => {
                write!(text, "\n  recommended for the worst 5 % of the starts: {hz} Hz")
            }
            (Some(hz), _) => write!(
                text,
                "\n  recommended for the worst 5 % of the draws: {hz} Hz; not told apart: {alike} Hz"
            ),
            (None, Some(map)) => write!(
                text,
                "\n  nothing recommended: of fewer than {DRAWS_MIN} devices the worst 5 % have no lower bound; {} Hz leads, not \
                 told apart: {alike} Hz",
                map.cutoff_hz
            ),
        };
        if let Some(contour) = &summary.contour {
            let _ = write!(
                text,
                "\n  envelope95.csv: along it {:.1} % of {} fresh draws hold (95 % interval {:.1} to {:.1} %)",
                100.0 * contour.share,
                contour.draws,
                100.0 * contour.share_low,
                100.0 * contour.share_high
            );
        }
        text
    }
}
