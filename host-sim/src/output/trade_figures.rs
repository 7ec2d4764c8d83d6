//! The figures of a trade.

use super::figure::{Figure, FigureError, Mark, TradePanel, TradePlot, TradeSeries, hertz, trade};
use lab_trade::{
    Bench, Criterion, Form, Format, Variant, criterion,
    filters::{FilterRow, Filters},
    plant::Plants,
    table::{filter_points, pareto, plant_points},
};

/// Cutoffs that the Pareto figure shows, in Hz. For each of them, the figure shows the nearest cutoff that was tried.
const SHOWN_HZ: [f64; 4] = [1.0, 20.0, 200.0, 2000.0];
/// Variants that the figure over the cutoff shows.
const FOLLOWED: [(Format, Form); 8] = [
    (Format::I32Feedback, Form::Direct1),
    (Format::I32, Form::Direct1),
    (Format::Q15, Form::Direct1),
    (Format::Q15Feedback, Form::Direct1),
    (Format::Q15, Form::Delta),
    (Format::F32, Form::Direct1),
    (Format::F32, Form::Delta),
    (Format::F64, Form::Direct1),
];

/// Smallest error that is drawn, relative to the allowed error. Smaller errors are drawn at this value.
const SHARE_FLOOR: f64 = 1e-4;
/// Largest error that is drawn, relative to the allowed error. Larger errors are on the frame, like unstable filters.
const SHARE_CEILING: f64 = 1e6;

fn error_name(criterion: Criterion) -> &'static str {
    match criterion {
        Criterion::Response => "Response error",
        Criterion::Cutoff => "Error of the −3 dB frequency",
        Criterion::Bias => "Bias",
        Criterion::Noise => "Noise",
        Criterion::Rest => "Limit cycle",
        Criterion::Area => "Change of the area",
    }
}

fn colour(format: Format) -> usize {
    match format {
        Format::I32Feedback => 0,
        Format::I32 => 4,
        Format::Q15 => 1,
        Format::Q15Feedback => 3,
        Format::F32 => 2,
        Format::F64 => 6,
        Format::IdspDither | Format::IdspWide => 5,
        Format::CmsisQ31 | Format::Cmsis32x64 => 7,
    }
}

fn mark(variant: Variant) -> Mark {
    match (variant.format, variant.form) {
        (Format::IdspWide | Format::Cmsis32x64, _) => Mark::Square,
        (_, Form::Direct1) => Mark::Circle,
        (_, Form::Direct2Transposed) => Mark::Square,
        (_, Form::StateVariable) => Mark::Triangle,
        (_, Form::Delta) => Mark::Diamond,
    }
}

fn name(variant: Variant) -> String {
    match variant.format {
        Format::IdspDither | Format::IdspWide | Format::CmsisQ31 | Format::Cmsis32x64 => {
            variant.format.name().into()
        }
        format => format!("{} {}", format.name(), variant.form.name()),
    }
}

fn front(points: &[Option<[f64; 2]>]) -> Vec<[f64; 2]> {
    let mut front: Vec<[f64; 2]> = pareto(points)
        .into_iter()
        .zip(points)
        .filter_map(|(on, point)| point.filter(|[_, y]| on && y.is_finite()))
        .collect();
    front.sort_by(|a, b| a[0].total_cmp(&b[0]));
    front
}

/// Draws the error of the velocity over the processor cycles, at a few cutoffs.
pub fn filters(scene: &str, filters: &Filters, bench: &Bench) -> Result<Figure, FigureError> {
    let mut shown: Vec<usize> = vec![];
    for wanted in SHOWN_HZ {
        let far = |n: &usize| (filters.exact[*n].cutoff_hz / wanted).ln().abs();
        let nearest = (0..filters.exact.len()).min_by(|a, b| far(a).total_cmp(&far(b)));
        shown.extend(nearest.filter(|n| !shown.contains(n)));
    }
    let points: Vec<Vec<Option<[f64; 2]>>> =
        shown.iter().map(|&cutoff| filter_points(filters, cutoff, bench)).collect();
    let panels = shown.iter().zip(&points).map(|(&cutoff, points)| TradePanel {
        title: format!("cutoff {} Hz", hertz(filters.exact[cutoff].cutoff_hz)),
        y_title: "Velocity error [m/s]".into(),
        limit: Some(
            criterion::allowed_noise(filters.exact[cutoff].encoder.in_motion) * bench.m_per_s(),
        ),
        floor: 1e-18,
        front: front(points),
    });
    let series = Variant::ALL.iter().enumerate().map(|(number, &variant)| TradeSeries {
        name: name(variant),
        colour: colour(variant.format),
        mark: mark(variant),
        points: points
            .iter()
            .map(|points| points[number].into_iter().filter(|[_, y]| y.is_finite()).collect())
            .collect(),
    });
    trade(&TradePlot {
        title: format!("Velocity filters, error over cost, {scene}"),
        subtitle: "RMS distance from the exact filter on a quantised ramp; limit: a tenth of the encoder's noise, or 1 LSB"
            .into(),
        legend: "Format, form".into(),
        x_title: "Cycles on the Cortex-M4".into(),
        panels: panels.collect(),
        series: series.collect(),
        lines: false,
    })
}

/// Draws the cutoffs at which the formats fail. See [`cutoffs_plot`].
pub fn cutoffs(scene: &str, filters: &Filters) -> Result<Figure, FigureError> {
    trade(&cutoffs_plot(scene, filters))
}

/// The cutoffs at which the formats fail. There is a panel for each of [`Criterion::ALL`], which shows the error
/// divided by the allowed error. A filter is usable at a cutoff if its error is below the line in all panels.
pub fn cutoffs_plot(scene: &str, filters: &Filters) -> TradePlot {
    let shares = |variant: Variant, criterion: Criterion| -> Vec<[f64; 2]> {
        let rows = filters.rows.iter().filter(|row| row.variant == variant);
        let point = |row: &FilterRow| {
            let exact = &filters.exact[row.cutoff];
            let share = criterion.share(row.measured.as_ref().ok()?, exact)?;
            Some([exact.cutoff_hz, if share > SHARE_CEILING { f64::INFINITY } else { share }])
        };
        rows.filter_map(point).collect()
    };
    let series = FOLLOWED.map(|(format, form)| {
        let variant = Variant { format, form };
        TradeSeries {
            name: name(variant),
            colour: colour(format),
            mark: mark(variant),
            points: Criterion::ALL.map(|criterion| shares(variant, criterion)).into(),
        }
    });
    let panel = |criterion: Criterion| {
        let y_title = format!("{} / allowed", error_name(criterion));
        TradePanel { limit: Some(1.0), ..TradePanel::new("", y_title, SHARE_FLOOR) }
    };
    TradePlot {
        title: format!("Where number formats fail, {scene}"),
        subtitle: "a line ends where a format cannot have the cutoff; above 10⁶ is on the frame, below 10⁻⁴ at the lower edge"
            .into(),
        legend: "Format, form".into(),
        x_title: "Cutoff [Hz]".into(),
        panels: Criterion::ALL.map(panel).into(),
        series: series.into(),
        lines: true,
    }
}

/// Draws the error of the plant over the number of operations.
pub fn plants(scene: &str, plants: &Plants) -> Result<Figure, FigureError> {
    let points = plant_points(plants);
    let methods = [
        ("exact", 1, Mark::Diamond),
        ("semi-implicit-euler", 0, Mark::Circle),
        ("rk4", 2, Mark::Square),
        ("dormand-prince", 3, Mark::Triangle),
    ];
    let series = methods.map(|(name, colour, mark)| {
        let of = |value: fn(&lab_trade::plant::PlantMeasured) -> Option<f64>| -> Vec<[f64; 2]> {
            let rows = plants.rows.iter().filter(|row| row.method.name() == name);
            let mut points: Vec<[f64; 2]> = rows
                .filter_map(|row| {
                    let measured = row.measured.as_ref().ok()?;
                    let point = [measured.operations_per_s, value(measured)?];
                    Some(point).filter(|[_, y]| y.is_finite())
                })
                .collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            points
        };
        TradeSeries {
            name: name.into(),
            colour,
            mark,
            points: vec![of(|m| Some(m.trajectory_m)), of(|m| Some(m.area_change.abs()))],
        }
    });
    let chaotic = Some(plants.area_chaotic.abs()).filter(|change| *change > 0.0);
    trade(&TradePlot {
        title: format!("Ways to advance the plant, error over cost, {scene}"),
        subtitle:
            "limit: what moving the start by a quarter count does; 0 is drawn at the lower edge"
                .into(),
        legend: "Method".into(),
        x_title: "Operations per simulated second".into(),
        panels: vec![
            TradePanel {
                front: front(&points),
                ..TradePanel::new("", "Trajectory error [m]", 1e-17)
            },
            TradePanel { limit: chaotic, ..TradePanel::new("", "Change of the area", 1e-5) },
        ],
        series: series.into(),
        lines: true,
    })
}
