//! The area figure: Z-width area over the cutoff.

use super::axis::{Scale, Ticks, hertz, number, scaled_unit};
use super::colour::{ACCENT, DATA, FRAME, PAPER, QUIET, TEXT};
use super::drawing::{Anchor, Drawing, Stroke};
use super::panel::{self, Panel};
use super::{
    AXIS_TITLE_SIZE, Figure, FigureError, MARGIN, SUBTITLE_SIZE, TICK_SIZE, WIDTH, font,
    not_negative, positive,
};

const LEFT: f64 = 56.0;
const TOP: f64 = 116.0;
const RIGHT: f64 = WIDTH - MARGIN - 8.0;
const PLOT_HEIGHT: f64 = 220.0;
const BOTTOM: f64 = TOP + PLOT_HEIGHT;
const MOST_TICKS: usize = 6;
/// Keeps the mark of the largest area off the frame.
const HEADROOM: f64 = 1.03;
/// Room left and right of the outermost cutoffs, as a part of the whole axis and at least a factor.
const PAD_SHARE: f64 = 0.04;
const LEAST_PAD: f64 = 1.06;
const LONE_PAD: f64 = 2.0;

const KEY_BASELINE: f64 = 64.0;
const KEY_SWATCH: f64 = 20.0;
const KEY_GAP: f64 = 6.0;
const KEY_SPACE: f64 = 16.0;
const TOP_TITLE_BASELINE: f64 = TOP - 26.0;
const TOP_LABEL_BASELINE: f64 = TOP - 9.0;
const CAPTION_FIRST_DROP: f64 = 57.0;
const CAPTION_PITCH: f64 = 16.0;
/// Least space between the labels of two ticks.
const LABEL_SPACE: f64 = 7.0;

const TICK_LENGTH: f64 = 4.0;
const LINE_WIDTH: f64 = 1.6;
const BAR_WIDTH: f64 = 1.1;
const CAP_HALF: f64 = 3.5;
const DOT_RADIUS: f64 = 2.8;
/// The ring around the ideal mean, open so that its error bar shows.
const IDEAL_RADIUS: f64 = 6.0;
const IDEAL_HOLE: f64 = 4.2;
const BAND_OPACITY: f64 = 0.18;
const RANGE_OPACITY: f64 = 0.13;
/// The shade reaches this far beyond the cutoffs at its ends, so that their points lie inside.
const RANGE_MARGIN: f64 = 6.0;

/// What [`area()`] draws.
#[derive(Debug, Clone, PartialEq)]
pub struct AreaPlot {
    /// First line above the plot.
    pub title: String,
    /// Second line: scene, resolution, and what else identifies the run.
    pub subtitle: String,
    /// One point per cutoff, in ascending order of the cutoff.
    pub points: Vec<AreaPoint>,
    /// Nominal cutoff that is marked.
    pub ideal_cutoff_hz: Option<f64>,
    /// First and last nominal cutoff of the range that is shaded.
    pub ideal_range_hz: Option<[f64; 2]>,
    /// What the cutoff means, printed below the axis.
    pub convention: String,
}

/// The area of one cutoff over its repeats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AreaPoint {
    /// Nominal cutoff.
    pub cutoff_hz: f64,
    /// Frequency at which the discrete filter is down by 3 dB.
    pub true_cutoff_hz: f64,
    /// Mean area [N² s/m²].
    pub area: f64,
    /// Smallest area of the repeats [N² s/m²].
    pub area_low: f64,
    /// Largest area of the repeats [N² s/m²].
    pub area_high: f64,
}

/// Draws the area from 0 over the logarithm of the cutoff; the upper axis gives true frequencies.
///
/// # Errors
/// [`FigureError`] if an area is NaN, infinite or negative, or a cutoff is not greater than 0.
pub fn area(plot: &AreaPlot) -> Result<Figure, FigureError> {
    let largest = check(plot)?;
    let (factor, unit) = scaled_unit(largest, "N² s/m²");
    let room = RIGHT - LEFT;
    let caption = font::wrap(&plot.convention, SUBTITLE_SIZE, room);
    let height = BOTTOM + CAPTION_FIRST_DROP + CAPTION_PITCH * caption.len() as f64;

    let mut drawing = Drawing::new(WIDTH, height);
    panel::heading(&mut drawing, &plot.title, &plot.subtitle);
    let y = if largest > 0.0 {
        Ticks::around(0.0, HEADROOM * largest / factor, MOST_TICKS)
    } else {
        Ticks::nothing()
    };
    let panel = Panel::new(
        [LEFT, TOP],
        [RIGHT, BOTTOM],
        cutoff_scale(&plot.points),
        Scale::linear(0.0, y.high),
    );
    shade_range(&mut drawing, &panel, plot);
    panel.y_grid(&mut drawing, &y.values);
    draw_areas(&mut drawing, &panel, plot, factor);
    panel.frame(&mut drawing);
    panel.y_axis(&mut drawing, &y.values, &y.labels());
    panel.y_title(&mut drawing, &format!("Z-width area [{unit}]"));
    cutoff_axes(&mut drawing, &panel, plot);
    key(&mut drawing, plot);
    if plot.points.is_empty() || largest <= 0.0 {
        panel.remark(&mut drawing, "no stable wall found");
    }
    for (index, line) in caption.iter().enumerate() {
        let (text, size) = font::fit(line, SUBTITLE_SIZE, room);
        let y = BOTTOM + CAPTION_FIRST_DROP + CAPTION_PITCH * index as f64;
        drawing.text([LEFT, y], size, Anchor::Start, QUIET, &text);
    }
    Ok(Figure::new(drawing, &plot.title))
}

/// The largest area.
fn check(plot: &AreaPlot) -> Result<f64, FigureError> {
    let mut largest = 0.0_f64;
    for point in &plot.points {
        positive("cutoff_hz", point.cutoff_hz)?;
        positive("true_cutoff_hz", point.true_cutoff_hz)?;
        for (quantity, value) in
            [("area", point.area), ("area_low", point.area_low), ("area_high", point.area_high)]
        {
            largest = largest.max(not_negative(quantity, value)?);
        }
    }
    if let Some(cutoff_hz) = plot.ideal_cutoff_hz {
        positive("ideal_cutoff_hz", cutoff_hz)?;
    }
    for end_hz in plot.ideal_range_hz.into_iter().flatten() {
        positive("ideal_range_hz", end_hz)?;
    }
    Ok(largest)
}

fn cutoff_scale(points: &[AreaPoint]) -> Scale {
    let cutoffs = || points.iter().map(|point| point.cutoff_hz);
    let (low, high) = (cutoffs().fold(f64::INFINITY, f64::min), cutoffs().fold(0.0, f64::max));
    if points.is_empty() {
        return Scale::logarithmic(1.0, 10.0);
    }
    let pad = if low < high { (high / low).powf(PAD_SHARE).max(LEAST_PAD) } else { LONE_PAD };
    Scale::logarithmic(low / pad, high * pad)
}

fn shade_range(drawing: &mut Drawing, panel: &Panel, plot: &AreaPlot) {
    let (Some([low, high]), false) = (plot.ideal_range_hz, plot.points.is_empty()) else {
        return;
    };
    let left = (panel.x(low) - RANGE_MARGIN).clamp(panel.left, panel.right);
    let right = (panel.x(high) + RANGE_MARGIN).clamp(panel.left, panel.right);
    let ink = ACCENT.with_opacity(RANGE_OPACITY);
    drawing.rect([left, panel.top], [right, panel.bottom], ink);
}

fn draw_areas(drawing: &mut Drawing, panel: &Panel, plot: &AreaPlot, factor: f64) {
    let place = |point: &AreaPoint, area: f64| panel.at(point.cutoff_hz, area / factor);
    let highs = plot.points.iter().map(|point| place(point, point.area_high));
    let lows = plot.points.iter().rev().map(|point| place(point, point.area_low));
    drawing.area(highs.chain(lows).collect(), DATA.with_opacity(BAND_OPACITY));
    let means: Vec<[f64; 2]> = plot.points.iter().map(|point| place(point, point.area)).collect();
    drawing.named_line(means.clone(), Stroke::solid(DATA, LINE_WIDTH), "mean area".to_owned());
    for (point, mean) in plot.points.iter().zip(means) {
        let [x, low] = place(point, point.area_low);
        let [_, high] = place(point, point.area_high);
        let ideal = plot.ideal_cutoff_hz == Some(point.cutoff_hz);
        let ink = if ideal { ACCENT } else { DATA };
        if ideal {
            ring(drawing, mean);
        }
        let bar = Stroke::solid(ink, BAR_WIDTH);
        drawing.line(vec![[x, low], [x, high]], bar);
        for end in [low, high] {
            drawing.line(vec![[x - CAP_HALF, end], [x + CAP_HALF, end]], bar);
        }
        drawing.dot(mean, DOT_RADIUS, ink);
    }
}

fn ring(drawing: &mut Drawing, at: [f64; 2]) {
    drawing.dot(at, IDEAL_RADIUS, ACCENT);
    drawing.dot(at, IDEAL_HOLE, PAPER);
}

/// Ticks at every cutoff; numbers, nominal below and true above, at those that have room.
fn cutoff_axes(drawing: &mut Drawing, panel: &Panel, plot: &AreaPlot) {
    let tick = Stroke::solid(FRAME, 1.0);
    let cutoffs: Vec<f64> = plot.points.iter().map(|point| point.cutoff_hz).collect();
    panel.x_ticks(drawing, &cutoffs);
    for cutoff_hz in &cutoffs {
        let x = panel.x(*cutoff_hz);
        drawing.line(vec![[x, panel.top - TICK_LENGTH], [x, panel.top]], tick);
    }
    for point in readable(panel, plot) {
        let ideal = plot.ideal_cutoff_hz == Some(point.cutoff_hz);
        let ink = if ideal { ACCENT } else { TEXT };
        let x = panel.x(point.cutoff_hz);
        let nominal = hertz(point.cutoff_hz);
        let below = panel.bottom + 17.0;
        drawing.text([x, below], TICK_SIZE, Anchor::Middle, ink, &nominal);
        let above = [x, TOP_LABEL_BASELINE];
        drawing.text(above, TICK_SIZE, Anchor::Middle, ink, &rounded(point));
    }
    panel.x_title(drawing, "Cutoff, nominal [Hz]");
    drawing.text(
        [panel.centre()[0], TOP_TITLE_BASELINE],
        AXIS_TITLE_SIZE,
        Anchor::Middle,
        TEXT,
        "True −3 dB frequency [Hz]",
    );
}

fn rounded(point: &AreaPoint) -> String {
    if point.true_cutoff_hz < 10.0 {
        hertz(point.true_cutoff_hz)
    } else {
        number(point.true_cutoff_hz, 0)
    }
}

/// Points whose numbers fit side by side: the ideal one first, then the ends of the ideal range and
/// of the axis, then the roundest numbers.
fn readable<'a>(panel: &Panel, plot: &'a AreaPlot) -> Vec<&'a AreaPoint> {
    let ends = [plot.points.first(), plot.points.last()];
    let rank = |point: &AreaPoint| {
        let cutoff_hz = point.cutoff_hz;
        if plot.ideal_cutoff_hz == Some(cutoff_hz) {
            0
        } else if ends.contains(&Some(point)) {
            1
        } else if plot.ideal_range_hz.is_some_and(|range| range.contains(&cutoff_hz)) {
            2
        } else {
            let digits = hertz(cutoff_hz).replace('.', "");
            2 + digits.trim_matches('0').len()
        }
    };
    let mut candidates: Vec<&AreaPoint> = plot.points.iter().collect();
    candidates.sort_by_key(|point| rank(point));
    let mut taken: Vec<[f64; 2]> = Vec::new();
    candidates.retain(|point| {
        let widest = font::width(&hertz(point.cutoff_hz), TICK_SIZE)
            .max(font::width(&rounded(point), TICK_SIZE));
        let (x, half) = (panel.x(point.cutoff_hz), (widest + LABEL_SPACE) / 2.0);
        let span = [x - half, x + half];
        let free = taken.iter().all(|other| span[1] <= other[0] || other[1] <= span[0]);
        if free {
            taken.push(span);
        }
        free
    });
    candidates
}

/// One line above the plot that says what is what, so that nothing stands on the data.
fn key(drawing: &mut Drawing, plot: &AreaPlot) {
    let middle = KEY_BASELINE - 0.35 * SUBTITLE_SIZE;
    let half = KEY_SWATCH / 2.0;
    let mut x = LEFT;
    let label = |drawing: &mut Drawing, x: &mut f64, text: &str| {
        let at = [*x + KEY_SWATCH + KEY_GAP, KEY_BASELINE];
        drawing.text(at, SUBTITLE_SIZE, Anchor::Start, TEXT, text);
        *x = at[0] + font::width(text, SUBTITLE_SIZE) + KEY_SPACE;
    };

    let bar = Stroke::solid(DATA, BAR_WIDTH);
    let band = DATA.with_opacity(BAND_OPACITY);
    drawing.rect([x, middle - 4.0], [x + KEY_SWATCH, middle + 4.0], band);
    drawing.line(vec![[x, middle], [x + KEY_SWATCH, middle]], Stroke::solid(DATA, LINE_WIDTH));
    drawing.line(vec![[x + half, middle - 4.0], [x + half, middle + 4.0]], bar);
    drawing.dot([x + half, middle], DOT_RADIUS, DATA);
    label(drawing, &mut x, "mean, lowest to highest");

    if let Some([low, high]) = plot.ideal_range_hz {
        let ink = ACCENT.with_opacity(2.0 * RANGE_OPACITY);
        drawing.rect([x, middle - 6.0], [x + KEY_SWATCH, middle + 6.0], ink);
        let text = if low < high {
            format!("ideal range {} to {} Hz", hertz(low), hertz(high))
        } else {
            "ideal range".to_owned()
        };
        label(drawing, &mut x, &text);
    }
    if let Some(ideal_hz) = plot.ideal_cutoff_hz {
        ring(drawing, [x + half, middle]);
        drawing.dot([x + half, middle], DOT_RADIUS, ACCENT);
        label(drawing, &mut x, &format!("ideal {} Hz", hertz(ideal_hz)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::testing::{check as look, parse};

    /// Areas of an existing run at 1 µm.
    const AREAS: [(f64, f64, f64); 6] = [
        (50.0, 50.0, 6.8e5),
        (500.0, 496.0, 2.65e7),
        (1000.0, 968.9, 3.9e7),
        (1500.0, 1401.8, 4.4e7),
        (2000.0, 1785.7, 4.69e7),
        (4000.0, 2860.5, 4.55e7),
    ];

    fn plot(points: Vec<AreaPoint>) -> AreaPlot {
        AreaPlot {
            title: "Areas <1 µm>".to_owned(),
            subtitle: "resolution 1 µm".to_owned(),
            points,
            ideal_cutoff_hz: Some(2000.0),
            ideal_range_hz: Some([1500.0, 2000.0]),
            convention: "bilinear, not pre-warped: nominal 2000 Hz is −3 dB at 1785.7 Hz"
                .to_owned(),
        }
    }

    fn point(cutoff_hz: f64, true_cutoff_hz: f64, area: f64) -> AreaPoint {
        AreaPoint { cutoff_hz, true_cutoff_hz, area, area_low: 0.99 * area, area_high: 1.01 * area }
    }

    fn run() -> Vec<AreaPoint> {
        AREAS.iter().map(|(fc, ft, area)| point(*fc, *ft, *area)).collect()
    }

    #[test]
    fn it_names_axes_ideal_range_and_convention() {
        let figure = look(area, &plot(run()));
        for text in [
            "Z-width area [10⁷ N² s/m²]",
            "Cutoff, nominal [Hz]",
            "True −3 dB frequency [Hz]",
            "ideal range 1500 to 2000 Hz",
            "ideal 2000 Hz",
            ">1786<",
            "bilinear, not pre-warped: nominal 2000 Hz is −3 dB at 1785.7 Hz",
            "Areas &lt;1 µm&gt;",
        ] {
            assert!(figure.svg().contains(text), "{text} is missing");
        }
    }

    #[test]
    fn labels_of_crowded_cutoffs_keep_apart() {
        let points = (1..=30).map(|n| 150.0 * f64::from(n));
        let points: Vec<AreaPoint> = points.map(|fc| point(fc, 0.9 * fc, 1e4 * fc)).collect();
        let figure = look(area, &plot(points));
        let tree = parse(figure.svg());
        let boxes: Vec<_> = tree
            .root()
            .children()
            .iter()
            .filter(|node| matches!(node, resvg::usvg::Node::Text(_)))
            .map(resvg::usvg::Node::abs_bounding_box)
            .collect();
        assert!(boxes.len() > 20);
        for (index, one) in boxes.iter().enumerate() {
            for other in &boxes[index + 1..] {
                assert!(
                    one.right() <= other.left()
                        || other.right() <= one.left()
                        || one.bottom() <= other.top()
                        || other.bottom() <= one.top(),
                    "texts overlap: {one:?} {other:?}"
                );
            }
        }
    }

    #[test]
    fn one_cutoff_no_cutoff_and_no_area_have_figures() {
        look(area, &plot(vec![point(2000.0, 1785.7, 4.69e7)]));
        for points in [vec![], vec![point(50.0, 50.0, 0.0), point(100.0, 99.97, 0.0)]] {
            let figure = look(area, &plot(points));
            assert!(figure.svg().contains("no stable wall found"));
        }
    }

    #[test]
    fn what_is_no_number_is_an_error() {
        let quantity = "area";
        let bad = plot(vec![point(50.0, 50.0, f64::NAN)]);
        assert_eq!(area(&bad), Err(FigureError::NotPlottable { quantity }));
        let bad = plot(vec![point(50.0, 50.0, -1.0)]);
        assert_eq!(area(&bad), Err(FigureError::Negative { quantity }));
        let quantity = "cutoff_hz";
        let bad = plot(vec![point(0.0, 50.0, 1.0)]);
        assert_eq!(area(&bad), Err(FigureError::NotPositive { quantity }));
    }
}
