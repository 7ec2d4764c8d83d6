//! The files of a sweep: tables, figures, report.

use std::fmt::Write as _;

use serde::Serialize;
use zwidth::{experiment::Ended, velocity::EstimatorName};

use crate::{
    error::Error,
    notation::rounded,
    output::{
        SCHEMA_VERSION,
        figure::{self, AreaPlot, AreaPoint, Curve, Figure, ZwidthPlot},
        files::{FolderPlace, MANIFEST, Outputs, json},
        in_units::InUnits,
        levers::{LeverStudy, LeverSummary},
        limits::{LimitStudy, LimitSummary},
        manifest::Manifest,
        probability::{ProbabilityStudy, ProbabilitySummary},
        rates::{RateStudy, RateSummary},
        recommended::{Answer, by_its_own, sentences},
        report::{self, Report, ReportFigure},
        trace,
    },
    scene::NamedScene,
    simulation::{
        prepared::{Numeric, PreparedScene, WallHit},
        trace::Trace,
    },
    study::{
        envelope::{self, Envelope},
        recommended::{QuietStudy, Recommended},
        sweep::{CutoffResult, SweepResult, start_offset_counts},
    },
};

/// All files that a study may have. `sensitivity.csv` and the figure of a hit are optional.
pub const FILES: &[&str] = &[
    QUIET_AREAS,
    QUIET_BOUNDARY,
    "quiet",
    "quiet_area",
    "boundary.csv",
    "areas.csv",
    "envelope.csv",
    "summary.json",
    "zwidth",
    "area",
    "hit",
    "report.html",
    SENSITIVITY,
    LIMITS,
    "limits",
    LEVERS,
    "levers",
    RATES,
    "rates",
    PROBABILITY,
    CONTOURS,
    ENVELOPE95,
    "probability",
];
const QUIET_AREAS: &str = "quiet_areas.csv";
const QUIET_BOUNDARY: &str = "quiet_boundary.csv";
const SENSITIVITY: &str = "sensitivity.csv";
const LIMITS: &str = "limits.csv";
const LEVERS: &str = "levers.csv";
const RATES: &str = "rates.csv";
const PROBABILITY: &str = "probability.csv";
const CONTOURS: &str = "contours.csv";
const ENVELOPE95: &str = "envelope95.csv";

#[derive(Clone, Debug)]
pub struct VariantResult {
    pub name: String,
    pub change: String,
    pub result: SweepResult,
}

#[derive(Clone, Debug)]
pub struct Study {
    pub scene: NamedScene,
    pub prepared: PreparedScene,
    pub numeric: Numeric,
    pub repeats: u32,
    pub result: SweepResult,
    /// For each cutoff, the walls that the firmware may render.
    pub envelopes: Vec<Envelope>,
    /// The sensitivity study. Empty if the user has not asked for this study.
    pub variants: Vec<VariantResult>,
    /// The study of other limits. `None` if the user has not asked for this study.
    pub limits: Option<LimitStudy>,
    /// The study of other loops. `None` if the user has not asked for this study.
    pub levers: Option<LeverStudy>,
    /// The study of other rates. `None` if the user has not asked for this study.
    pub rates: Option<RateStudy>,
    /// The probabilities of walls. `None` if the user has not asked for probabilities.
    pub probability: Option<ProbabilityStudy>,
    /// Reason why the default second limit was left out.
    pub limits_left_out: Option<String>,
    /// The study that recommends a cutoff. `None` for the paper's own study.
    pub quiet: Option<QuietStudy>,
    pub command: String,
}

#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    schema_version: u32,
    scene: String,
    #[serde(flatten)]
    answer: Option<Answer>,
    numeric: &'static str,
    repeats: u32,
    ideal_cutoff_hz: Option<f64>,
    ideal_true_cutoff_hz: Option<f64>,
    ideal_cutoff_range_hz: Option<[f64; 2]>,
    ideal_cutoff_range_basis: Option<&'static str>,
    cutoffs: Vec<CutoffSummary>,
    notes: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    estimated: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    sensitivity: Vec<VariantSummary>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    limits: Vec<LimitSummary>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    levers: Vec<LeverSummary>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    rates: Vec<RateSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    probability: Option<ProbabilitySummary>,
}

#[derive(Clone, Debug, Serialize)]
struct CutoffSummary {
    #[serde(flatten)]
    areas: AreaPoint,
    walks: Vec<WalkSummary>,
}

#[derive(Clone, Debug, Serialize)]
struct WalkSummary {
    area_n2_s_per_m2: f64,
    hits: u64,
    ended_by: &'static str,
}

#[derive(Clone, Debug, Serialize)]
struct VariantSummary {
    name: String,
    change: String,
    ideal_cutoff_hz: Option<f64>,
    ideal_cutoff_range_hz: Option<[f64; 2]>,
    area_at_ideal_n2_s_per_m2: Option<f64>,
}

/// A sentence that says what the frequencies mean.
fn convention(study: &Study, best_hz: Option<f64>) -> String {
    let scene = &study.scene.scene;
    let shown = best_hz.or_else(|| study.result.cutoffs.last().map(|last| last.cutoff_hz));
    let filter = match scene.velocity.estimator() {
        EstimatorName::ButterworthPrewarped | EstimatorName::FirstOrderPrewarped => {
            return "Bilinear, pre-warped: the nominal cutoff is the -3 dB frequency.".into();
        }
        EstimatorName::Butterworth | EstimatorName::FirstOrder | EstimatorName::SecondOrder => {
            "Bilinear, not pre-warped"
        }
        EstimatorName::Biquad => "The nominal cutoff is the frequency of the poles",
        _ => {
            return "The nominal cutoff is a parameter of the estimator, not a -3 dB frequency."
                .into();
        }
    };
    let Some(nominal) = shown else { return format!("{filter}.") };
    let true_hz = scene.true_cutoff_hz(nominal);
    format!("{filter}: nominal {nominal} Hz is -3 dB at {true_hz:.1} Hz.")
}

/// Encoder, rates and latency, then `criterion`.
fn subtitle(study: &Study, criterion: &str) -> String {
    let scene = &study.scene.scene;
    let rate_khz = scene.control.rate_hz / 1e3;
    format!(
        "{} encoder, {rate_khz} kHz sampling, {} kHz output, latency {} samples{criterion}",
        scene.units.said(scene.encoder.resolution_m * 1e6, "um"),
        rounded(rate_khz / f64::from(scene.actuator.period), DIGITS),
        scene.actuator.latency,
    )
}

/// The limit of the scene's own criterion, as the end of a subtitle.
fn own_limit(study: &Study) -> String {
    let scene = &study.scene.scene;
    format!(", RMS limit {}", scene.units.said(scene.wall_hit.rms_limit_m * 1e6, "um"))
}

/// Number of significant digits. A conversion of units may change further digits.
const DIGITS: usize = 10;

impl Study {
    pub fn summary(&self) -> Summary {
        let ideal = self.result.ideal;
        Summary {
            schema_version: SCHEMA_VERSION,
            scene: self.scene.name.clone(),
            answer: self.quiet.as_ref().map(|quiet| Answer::of(&self.scene, quiet)),
            numeric: self.numeric.name(),
            repeats: self.repeats,
            ideal_cutoff_hz: ideal.map(|ideal| ideal.cutoff_hz),
            ideal_true_cutoff_hz: ideal.map(|i| self.scene.scene.true_cutoff_hz(i.cutoff_hz)),
            ideal_cutoff_range_hz: ideal.map(|ideal| ideal.range_hz),
            ideal_cutoff_range_basis: ideal.map(|ideal| ideal.basis.name()),
            cutoffs: self.result.cutoffs.iter().map(cutoff_summary).collect(),
            notes: self.notes(),
            estimated: self.scene.scene.estimated_keys(),
            sensitivity: self.variants.iter().map(variant_summary).collect(),
            limits: self.limits.as_ref().map(LimitStudy::summary).unwrap_or_default(),
            levers: self.levers.as_ref().map(LeverStudy::summary).unwrap_or_default(),
            rates: self.rates.as_ref().map(RateStudy::summary).unwrap_or_default(),
            probability: self.probability.as_ref().map(ProbabilityStudy::summary),
        }
    }

    /// The recommended cutoff, the next step, and the result by the scene's own criterion.
    pub fn answers(&self) -> Vec<String> {
        let Some(quiet) = &self.quiet else { return vec![] };
        let own = by_its_own(&self.scene, self.result.ideal);
        sentences(&self.scene, quiet).into_iter().chain(own).collect()
    }

    pub fn write(&self, outputs: &mut Outputs, to: FolderPlace) -> Result<(), Error> {
        let manifest = Manifest::new(self.command.clone(), &self.scene);
        let mut figures = vec![];
        let shown = [
            ("quiet_area", self.quiet_area()?),
            ("quiet", self.quiet_walls()?),
            ("zwidth", Some(self.zwidth()?)),
            ("area", Some(self.area()?)),
            ("hit", self.hit()?),
        ];
        for (stem, shown) in shown {
            if let Some(shown) = shown {
                outputs.add_figure(to, stem, &shown.figure)?;
                figures.push(shown);
            }
        }
        let name = &self.scene.name;
        let limits = self.limits.as_ref().map(|limits| limits.figure(name)).transpose()?;
        let levers = self.levers.as_ref().map(|levers| levers.figure(name)).transpose()?;
        let rates = self.rates.as_ref().map(|rates| rates.figure(name)).transpose()?;
        let sure = self.probability.as_ref().map(|sure| sure.figure(&self.scene)).transpose()?;
        for (stem, figure, caption) in [
            ("limits", limits, LimitStudy::CAPTION),
            ("levers", levers, LeverStudy::CAPTION),
            ("rates", rates, RateStudy::CAPTION),
            ("probability", sure, ProbabilityStudy::CAPTION),
        ] {
            if let Some(figure) = figure.flatten() {
                outputs.add_figure(to, stem, &figure)?;
                figures.push(ReportFigure { figure, caption: caption.into() });
            }
        }
        let mut tables = vec![
            ("boundary.csv", boundary_csv(&self.result.cutoffs, self.repeats)),
            ("areas.csv", areas_csv(&self.result.cutoffs)),
            ("envelope.csv", self.envelope_csv(&self.envelopes)),
        ];
        if let Some(probability) = &self.probability {
            tables.push((PROBABILITY, probability.csv()));
            tables.push((CONTOURS, probability.contours_csv()));
            tables.push((ENVELOPE95, self.envelope_csv(&probability.envelope())));
        }
        if let Some(quiet) = &self.quiet {
            tables.push((QUIET_AREAS, areas_csv(&quiet.cutoffs)));
            tables.push((QUIET_BOUNDARY, boundary_csv(&quiet.cutoffs, 1)));
        }
        tables.extend((!self.variants.is_empty()).then(|| (SENSITIVITY, self.sensitivity_csv())));
        tables.extend(self.levers.as_ref().map(|levers| (LEVERS, levers.csv())));
        tables.extend(self.rates.as_ref().map(|rates| (RATES, rates.csv())));
        tables.extend(self.limits.as_ref().map(|limits| (LIMITS, limits.csv())));
        for (name, table) in tables {
            outputs.add(to, name, table)?;
        }
        let summary = InUnits(self.scene.scene.units, self.summary());
        outputs.add(to, "summary.json", json(&summary)?)?;
        outputs.add(to, "report.html", self.report(figures, &manifest))?;
        outputs.add(to, MANIFEST, json(&manifest)?)
    }

    /// The recommendation, and the study with all cutoffs that were tried for it.
    fn recommended(&self) -> Option<(&QuietStudy, &Recommended)> {
        let quiet = self.quiet.as_ref()?;
        Some((quiet, quiet.recommended.as_ref().ok()?))
    }

    fn quiet_area(&self) -> Result<Option<ReportFigure>, Error> {
        let Some((quiet, found)) = self.recommended() else { return Ok(None) };
        let walks = "Quiet walls: one walk per cutoff, each wall at four pushes.";
        let figure = self.areas(
            [&format!("Area of quiet walls over the cutoff, {}", self.scene.name), ""],
            AreaPlot::DIAL_IN,
            quiet.cutoffs.iter(),
            Some((found.cutoff_hz, found.range_hz)),
            walks,
        )?;
        let caption = "The area below the boundary of the quiet walls. At a quiet wall, motion and force rest at four \
                       pushes, and the stiffness is as commanded. The sweep added cutoffs beside the best one.";
        Ok(Some(ReportFigure { figure, caption: caption.into() }))
    }

    /// The figure of the quiet walls. It shows the boundaries of the user's cutoffs and of the recommended cutoff.
    fn quiet_walls(&self) -> Result<Option<ReportFigure>, Error> {
        let Some((quiet, found)) = self.recommended() else { return Ok(None) };
        let asked = |cutoff_hz| self.result.cutoffs.iter().any(|of| of.cutoff_hz == cutoff_hz);
        let shown = |of: &&CutoffResult| of.cutoff_hz == found.cutoff_hz || asked(of.cutoff_hz);
        let figure = self.boundaries(
            [&format!("Quiet walls, {}", self.scene.name), ""],
            "dial in",
            Some(found.cutoff_hz),
            quiet.cutoffs.iter().filter(shown),
        )?;
        let caption = "Boundary of the quiet walls, one curve per nominal cutoff: the largest K that the walk found \
                       quiet at each B.";
        Ok(Some(ReportFigure { figure, caption: caption.into() }))
    }

    fn zwidth(&self) -> Result<ReportFigure, Error> {
        let figure = self.boundaries(
            [&format!("Z-width, {}", self.scene.name), &own_limit(self)],
            "ideal",
            self.result.ideal.map(|ideal| ideal.cutoff_hz),
            self.result.cutoffs.iter(),
        )?;
        let caption = "Boundary of the stable walls, one curve per nominal cutoff: the largest K that the walk \
                       found stable at each B. The first of the repeated walks is shown.";
        Ok(ReportFigure { figure, caption: self.by_its_own(caption) })
    }

    fn boundaries<'a>(
        &self,
        [title, criterion]: [&str; 2],
        marked: &'static str,
        best_hz: Option<f64>,
        cutoffs: impl Iterator<Item = &'a CutoffResult>,
    ) -> Result<Figure, Error> {
        let curves = cutoffs.map(|of| {
            let first = of.boundaries.first();
            let points = first.map(|first| first.points.clone()).unwrap_or_default();
            let is_best = best_hz == Some(of.cutoff_hz);
            Curve::of_cutoff(of.cutoff_hz, of.true_cutoff_hz, is_best, points)
        });
        Ok(figure::zwidth(&ZwidthPlot {
            title: title.into(),
            subtitle: subtitle(self, criterion),
            units: self.scene.scene.units,
            legend: Curve::CUTOFF_LEGEND.into(),
            marked,
            curves: curves.collect(),
        })?)
    }

    /// The caption of a figure by the scene's own criterion. If the recommendation has another criterion, the caption
    /// says so.
    fn by_its_own(&self, caption: &str) -> String {
        let Some(_) = self.recommended() else { return caption.into() };
        let criterion = self.scene.scene.wall_hit.criterion.name();
        format!("By the scene's own criterion, {criterion}, and not by quiet walls. {caption}")
    }

    fn area(&self) -> Result<ReportFigure, Error> {
        let ideal = self.result.ideal;
        let walks = match self.repeats {
            1 => "One walk per cutoff.".to_owned(),
            n => format!("Points are means of {n} walks, starts spread over one count."),
        };
        let figure = self.areas(
            [&format!("Z-width area over the cutoff, {}", self.scene.name), &own_limit(self)],
            AreaPlot::IDEAL,
            self.result.cutoffs.iter(),
            ideal.map(|ideal| (ideal.cutoff_hz, ideal.range_hz)),
            &walks,
        )?;
        let caption = convention(self, ideal.map(|ideal| ideal.cutoff_hz));
        Ok(ReportFigure { figure, caption: self.by_its_own(&caption) })
    }

    /// The area figure. `best` is the cutoff that is marked, with its range.
    fn areas<'a>(
        &self,
        [title, criterion]: [&str; 2],
        names: [&'static str; 2],
        cutoffs: impl Iterator<Item = &'a CutoffResult>,
        best: Option<(f64, [f64; 2])>,
        walks: &str,
    ) -> Result<Figure, Error> {
        let ideal_cutoff_hz = best.map(|(cutoff_hz, _)| cutoff_hz);
        Ok(figure::area(&AreaPlot {
            title: title.into(),
            subtitle: subtitle(self, criterion),
            units: self.scene.scene.units,
            points: cutoffs.map(area_row).collect(),
            ideal_cutoff_hz,
            ideal_range_hz: best.map(|(_, range_hz)| range_hz),
            names,
            convention: format!("{} {walks}", convention(self, ideal_cutoff_hz)),
        })?)
    }

    /// The figure of a hit on the stiffest wall at the ideal cutoff.
    fn hit(&self) -> Result<Option<ReportFigure>, Error> {
        let Some(ideal) = self.result.ideal else {
            return Ok(None);
        };
        let found = self.result.cutoffs.iter().find(|result| result.cutoff_hz == ideal.cutoff_hz);
        let stiffest = found.and_then(|result| {
            let points = result.boundaries.first()?.points.iter();
            let wall = points.max_by(|a, b| a.stiffness_n_per_m.total_cmp(&b.stiffness_n_per_m))?;
            Some((result.velocity, wall))
        });
        let Some((velocity, wall)) = stiffest else {
            return Ok(None);
        };
        let hit = WallHit {
            velocity,
            stiffness_n_per_m: wall.stiffness_n_per_m,
            damping_n_s_per_m: wall.damping_n_s_per_m,
            start_offset_counts: 0.0,
        };
        if Trace::refused(&self.prepared).is_some() {
            return Ok(None);
        }
        let mut samples = Trace::new(&self.prepared, &hit)?;
        let report = self.prepared.hit(self.numeric, &hit, |sample| samples.push(sample))?;
        let caption = "The hit on the stiffest wall of the boundary at the ideal cutoff: position \
                       over time, and the window that decides.";
        let figure = trace::figure(&samples, &self.scene, &hit, &report)?;
        Ok(Some(ReportFigure { figure, caption: self.by_its_own(caption) }))
    }

    /// Notes that a reader needs in order to understand the numbers.
    pub fn notes(&self) -> Vec<String> {
        let left_out = self.limits_left_out.iter();
        let left_out = left_out.map(|why| format!("the limit of one count is left out: {why}"));
        let units = self.scene.scene.units;
        let estimated = self.scene.scene.estimated_note();
        let notes = self.result.notes().into_iter().chain(left_out);
        notes.map(|note| units.text(&note)).chain(estimated).collect()
    }

    /// The envelope for the firmware, see [`crate::study::envelope`].
    fn envelope_csv(&self, envelopes: &[Envelope]) -> String {
        format!("{}{}", envelope::HEADER, envelope::rows(&self.scene, envelopes))
    }

    fn sensitivity_csv(&self) -> String {
        let mut text = String::from(
            "variant,cutoff_hz,true_cutoff_hz,area_n2_s_per_m2,area_low_n2_s_per_m2,\
             area_high_n2_s_per_m2,schema_version\n",
        );
        for variant in &self.variants {
            for row in areas(&variant.result) {
                let _ = writeln!(text, "{},{},{SCHEMA_VERSION}", variant.name, area_cells(&row));
            }
        }
        text
    }

    /// Texts for people. They describe the additional results that the user has asked for.
    pub fn texts(&self) -> Vec<(&'static str, String)> {
        [
            self.limits.as_ref().map(|limits| ("Limits", limits.text(self.scene.scene.units))),
            self.levers.as_ref().map(|levers| ("When the loop acts", levers.text())),
            self.rates.as_ref().map(|rates| ("Encoder rate and output rate", rates.text())),
            self.probability.as_ref().map(|sure| ("How sure", sure.text(self.scene.scene.units))),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    fn report(&self, figures: Vec<ReportFigure>, manifest: &Manifest) -> String {
        let mut answers = self.answers().into_iter();
        let answer = answers.next();
        let mut notes: Vec<String> = answers.chain(self.notes()).collect();
        notes.extend(self.variants.iter().map(VariantResult::sentence));
        report::html(&Report {
            title: format!("{}: {}", self.scene.name, subtitle(self, "")),
            ideal_cutoff_hz: self.result.ideal.map(|ideal| ideal.cutoff_hz),
            ideal_cutoff_range_hz: self.result.ideal.map(|ideal| ideal.range_hz),
            answer,
            figures,
            units: self.scene.scene.units,
            areas: areas(&self.result).collect(),
            texts: self.texts(),
            notes,
            scene: self.scene.text.clone(),
            provenance: manifest.facts(),
        })
    }
}

/// Text of `boundary.csv`, in m and N.
pub fn boundary_csv(cutoffs: &[CutoffResult], repeats: u32) -> String {
    let mut text =
        String::from("cutoff_hz,repeat,start_offset_counts,damping_n_s_per_m,stiffness_n_per_m\n");
    for result in cutoffs {
        for (repeat, boundary) in (0u32..).zip(result.boundaries.iter()) {
            let offset = start_offset_counts(repeat, repeats);
            for point in &boundary.points {
                let (b, k) = (point.damping_n_s_per_m, point.stiffness_n_per_m);
                let _ = writeln!(text, "{},{repeat},{offset},{b},{k}", result.cutoff_hz);
            }
        }
    }
    text
}

/// Text of `areas.csv`, in m and N.
pub fn areas_csv(cutoffs: &[CutoffResult]) -> String {
    let mut text = String::from(
        "cutoff_hz,true_cutoff_hz,area,area_low,area_high,stiffness_peak_n_per_m,damping_max_n_s_per_m\n",
    );
    for row in cutoffs.iter().map(area_row) {
        let (k, b) = (row.stiffness_peak_n_per_m, row.damping_max_n_s_per_m);
        let _ = writeln!(text, "{},{k},{b}", area_cells(&row));
    }
    text
}

impl VariantResult {
    /// A sentence that gives the change, and the ideal cutoff after this change.
    pub fn sentence(&self) -> String {
        match self.result.ideal {
            None => format!("{}: no stable wall at any cutoff", self.change),
            Some(ideal) => {
                let [low, high] = ideal.range_hz;
                let (change, cutoff_hz) = (&self.change, ideal.cutoff_hz);
                let edge = if self.result.ends_at_edge() {
                    " (an end of the cutoffs that were tried; it may go on beyond)"
                } else {
                    ""
                };
                format!(
                    "{change}: ideal range {low} to {high} Hz{edge}, ideal cutoff {cutoff_hz} Hz"
                )
            }
        }
    }
}

fn cutoff_summary(result: &CutoffResult) -> CutoffSummary {
    let walks = result.boundaries.iter().map(|boundary| WalkSummary {
        area_n2_s_per_m2: boundary.area,
        hits: boundary.hits,
        ended_by: boundary.ended.map_or("first_point_unstable", Ended::name),
    });
    CutoffSummary { areas: area_row(result), walks: walks.collect() }
}

/// The numbers of each cutoff, for tables and figures.
pub fn areas(result: &SweepResult) -> impl Iterator<Item = AreaPoint> {
    result.cutoffs.iter().map(area_row)
}

/// The first cells of a row in all CSV tables of areas.
fn area_cells(row: &AreaPoint) -> String {
    let AreaPoint { cutoff_hz, true_cutoff_hz, area, area_low, area_high, .. } = row;
    format!("{cutoff_hz},{true_cutoff_hz},{area},{area_low},{area_high}")
}

fn area_row(result: &CutoffResult) -> AreaPoint {
    let [area_low, area_high] = result.boundaries.area_range();
    AreaPoint {
        cutoff_hz: result.cutoff_hz,
        true_cutoff_hz: result.true_cutoff_hz,
        area: result.boundaries.area(),
        area_low,
        area_high,
        stiffness_peak_n_per_m: result.boundaries.stiffness_peak_n_per_m(),
        damping_max_n_s_per_m: result.boundaries.damping_max_n_s_per_m(),
    }
}

fn variant_summary(variant: &VariantResult) -> VariantSummary {
    let ideal = variant.result.ideal;
    let at_ideal = ideal.and_then(|ideal| {
        variant.result.cutoffs.iter().find(|result| result.cutoff_hz == ideal.cutoff_hz)
    });
    VariantSummary {
        name: variant.name.clone(),
        change: variant.change.clone(),
        ideal_cutoff_hz: ideal.map(|ideal| ideal.cutoff_hz),
        ideal_cutoff_range_hz: ideal.map(|ideal| ideal.range_hz),
        area_at_ideal_n2_s_per_m2: at_ideal.map(|result| result.boundaries.area()),
    }
}
