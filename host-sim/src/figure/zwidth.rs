//! The Z-width figure: stiffness over damping, one boundary per cutoff.

use super::axis::{Scale, Ticks, hertz};
use super::colour::{ACCENT, PAPER, QUIET, TEXT, ordered};
use super::drawing::{Anchor, Drawing, Ink, Stroke};
use super::panel::{self, Panel};
use super::{AXIS_TITLE_SIZE, Figure, FigureError, MARGIN, WIDTH, font, not_negative, positive};
use crate::walk::BoundaryPoint;

const HEIGHT: f64 = 400.0;
const LEFT: f64 = 64.0;
const TOP: f64 = 58.0;
const BOTTOM: f64 = HEIGHT - 50.0;
const MOST_TICKS: usize = 8;
/// Below this the axis counts in N/m.
const KILO_FROM_N_PER_M: f64 = 2000.0;

const CURVE_WIDTH: f64 = 1.4;
const IDEAL_WIDTH: f64 = 2.4;
const IDEAL_HALO: f64 = 4.0;
const DOT_RADIUS: f64 = 1.9;
const IDEAL_DOT_RADIUS: f64 = 2.6;
/// Points nearer than this on average are drawn as a line only.
const DOT_SPACING: f64 = 4.0;
/// From this many curves on, the dots are smaller by [`CROWD_SHARE`].
const CROWD: usize = 16;
const CROWD_SHARE: f64 = 0.7;

const LEGEND_SIZE: f64 = 12.0;
const LEGEND_PITCH: f64 = 17.0;
const LEGEND_GAP: f64 = 14.0;
const LEGEND_SWATCH: f64 = 20.0;
const LEGEND_SWATCH_GAP: f64 = 6.0;
const LEGEND_FIRST_BASELINE: f64 = TOP + 32.0;
const LEGEND_ROWS: usize = 17;
const LEGEND_COLUMNS: usize = 2;

/// What [`zwidth()`] draws.
#[derive(Debug, Clone, PartialEq)]
pub struct ZwidthPlot {
    /// First line above the plot.
    pub title: String,
    /// Second line: scene, resolution, and what else identifies the run.
    pub subtitle: String,
    /// One boundary per cutoff, in ascending order of the cutoff: the colours follow it.
    pub curves: Vec<Curve>,
    /// Nominal cutoff of the curve that is emphasised.
    pub ideal_cutoff_hz: Option<f64>,
}

/// The boundary of one cutoff.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Nominal cutoff, which names the curve.
    pub cutoff_hz: f64,
    /// Frequency at which the discrete filter is down by 3 dB; shown under the pointer.
    pub true_cutoff_hz: f64,
    /// The boundary in the order of the walk; empty if no wall was stable.
    pub points: Vec<BoundaryPoint>,
}

/// Draws stiffness over damping, both from 0, with a legend of the cutoffs.
///
/// Beyond 34 curves the legend names every second, third, .. one, the ideal one always.
///
/// # Errors
/// [`FigureError`] if a number is NaN, infinite or negative, or a cutoff is 0.
pub fn zwidth(plot: &ZwidthPlot) -> Result<Figure, FigureError> {
    let [largest_damping, largest_stiffness] = largest(plot)?;
    let (unit, factor) =
        if largest_stiffness < KILO_FROM_N_PER_M { ("N/m", 1.0) } else { ("kN/m", 1000.0) };
    let empty = plot.curves.iter().all(|curve| curve.points.is_empty());

    let mut drawing = Drawing::new(WIDTH, HEIGHT);
    panel::heading(&mut drawing, &plot.title, &plot.subtitle);
    let legend = Legend::of(plot);
    let x = Ticks::around(0.0, largest_damping, MOST_TICKS);
    let y = Ticks::around(0.0, largest_stiffness / factor, MOST_TICKS);
    let panel = Panel::new(
        [LEFT, TOP],
        [WIDTH - MARGIN - legend.width(), BOTTOM],
        Scale::linear(0.0, x.high),
        Scale::linear(0.0, y.high),
    );
    if empty {
        panel.remark(&mut drawing, "no stable wall found");
    } else {
        panel.x_grid(&mut drawing, &x.values);
        panel.y_grid(&mut drawing, &y.values);
        panel.x_ticks(&mut drawing, &x.values);
        panel.x_labels(&mut drawing, &x.values, &x.labels());
        panel.y_axis(&mut drawing, &y.values, &y.labels());
    }
    panel.frame(&mut drawing);
    panel.x_title(&mut drawing, "Damping B [N s/m]");
    panel.y_title(&mut drawing, &format!("Stiffness K [{unit}]"));

    // The ideal curve comes last, on top of the others.
    let styles = styles(plot);
    for on_top in [false, true] {
        for (curve, style) in plot.curves.iter().zip(&styles) {
            if style.ideal == on_top {
                draw_curve(&mut drawing, &panel, curve, *style, factor);
            }
        }
    }
    legend.draw(&mut drawing, panel.right + LEGEND_GAP);
    Ok(Figure::new(drawing, &plot.title))
}

/// Largest damping and stiffness, at least 1 each so that the axes have a length.
fn largest(plot: &ZwidthPlot) -> Result<[f64; 2], FigureError> {
    let mut largest = [0.0_f64; 2];
    for curve in &plot.curves {
        positive("cutoff_hz", curve.cutoff_hz)?;
        positive("true_cutoff_hz", curve.true_cutoff_hz)?;
        for point in &curve.points {
            let damping = not_negative("damping_n_s_per_m", point.damping_n_s_per_m)?;
            let stiffness = not_negative("stiffness_n_per_m", point.stiffness_n_per_m)?;
            largest = [largest[0].max(damping), largest[1].max(stiffness)];
        }
    }
    Ok(largest.map(|value| if value > 0.0 { value } else { 1.0 }))
}

#[derive(Debug, Clone, Copy)]
struct Style {
    ink: Ink,
    ideal: bool,
    crowded: bool,
}

impl Style {
    fn width(self) -> f64 {
        if self.ideal { IDEAL_WIDTH } else { CURVE_WIDTH }
    }

    fn radius(self) -> f64 {
        match (self.ideal, self.crowded) {
            (true, _) => IDEAL_DOT_RADIUS,
            (false, false) => DOT_RADIUS,
            (false, true) => DOT_RADIUS * CROWD_SHARE,
        }
    }
}

fn styles(plot: &ZwidthPlot) -> Vec<Style> {
    let count = plot.curves.len();
    let style = |(index, curve): (usize, &Curve)| {
        let ideal = plot.ideal_cutoff_hz == Some(curve.cutoff_hz);
        let ink = if ideal { ACCENT } else { ordered(index, count) };
        let crowded = count >= CROWD;
        Style { ink, ideal, crowded }
    };
    plot.curves.iter().enumerate().map(style).collect()
}

fn draw_curve(drawing: &mut Drawing, panel: &Panel, curve: &Curve, style: Style, factor: f64) {
    let points: Vec<[f64; 2]> = curve
        .points
        .iter()
        .map(|point| panel.at(point.damping_n_s_per_m, point.stiffness_n_per_m / factor))
        .collect();
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return;
    };
    let gaps = (points.len() - 1) as f64;
    let dotted = (last[0] - first[0]).abs() >= gaps * DOT_SPACING;
    if style.ideal {
        drawing.line(points.clone(), Stroke::solid(PAPER, IDEAL_HALO));
    }
    let name = format!(
        "{} Hz nominal, −3 dB at {} Hz",
        hertz(curve.cutoff_hz),
        hertz(curve.true_cutoff_hz)
    );
    drawing.named_line(points.clone(), Stroke::solid(style.ink, style.width()), name);
    if dotted {
        for point in points {
            drawing.dot(point, style.radius(), style.ink);
        }
    }
}

struct Legend {
    entries: Vec<(String, Style)>,
    /// Every how many curves are named.
    every: usize,
    columns: usize,
    column_width: f64,
}

impl Legend {
    fn of(plot: &ZwidthPlot) -> Self {
        let every = plot.curves.len().div_ceil(LEGEND_ROWS * LEGEND_COLUMNS).max(1);
        let named = |(index, (curve, style)): (usize, (&Curve, Style))| {
            let mut text = hertz(curve.cutoff_hz);
            if curve.points.is_empty() {
                text.push_str(" (none)");
            } else if style.ideal {
                text.push_str(" ideal");
            }
            (style.ideal || index.is_multiple_of(every)).then_some((text, style))
        };
        let entries: Vec<_> =
            plot.curves.iter().zip(styles(plot)).enumerate().filter_map(named).collect();
        let widest =
            entries.iter().map(|(text, _)| font::width(text, LEGEND_SIZE)).fold(0.0, f64::max);
        Self {
            columns: entries.len().div_ceil(LEGEND_ROWS),
            column_width: LEGEND_SWATCH + LEGEND_SWATCH_GAP + widest + LEGEND_GAP,
            entries,
            every,
        }
    }

    fn width(&self) -> f64 {
        let titles = font::width("Cutoff [Hz]", AXIS_TITLE_SIZE) + LEGEND_GAP;
        (self.columns as f64 * self.column_width).max(titles)
    }

    fn draw(&self, drawing: &mut Drawing, left: f64) {
        let title = [left, TOP + 10.0];
        drawing.text(title, AXIS_TITLE_SIZE, Anchor::Start, TEXT, "Cutoff [Hz]");
        let rows = self.entries.len().div_ceil(self.columns.max(1)).max(1);
        for (index, (text, style)) in self.entries.iter().enumerate() {
            let x = left + (index / rows) as f64 * self.column_width;
            let y = LEGEND_FIRST_BASELINE + (index % rows) as f64 * LEGEND_PITCH;
            let line = y - 0.35 * LEGEND_SIZE;
            if !text.ends_with(')') {
                drawing.line(
                    vec![[x, line], [x + LEGEND_SWATCH, line]],
                    Stroke::solid(style.ink, style.width()),
                );
                drawing.dot([x + LEGEND_SWATCH / 2.0, line], style.radius(), style.ink);
            }
            let (at, ink) =
                (x + LEGEND_SWATCH + LEGEND_SWATCH_GAP, if style.ideal { ACCENT } else { TEXT });
            drawing.text([at, y], LEGEND_SIZE, Anchor::Start, ink, text);
        }
        if self.every > 1 {
            let note = format!("1 in {} named", self.every);
            let at = [left, BOTTOM + panel::X_TITLE_DROP];
            drawing.text(at, LEGEND_SIZE, Anchor::Start, QUIET, &note);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::testing::{check as look, parse};

    fn curve(cutoff_hz: f64, stiffness_n_per_m: f64, points: u32) -> Curve {
        let points = (1..=points).map(|n| BoundaryPoint {
            damping_n_s_per_m: 10.0 * f64::from(n),
            stiffness_n_per_m: stiffness_n_per_m * f64::from(n.min(70 - n) + 1) / 36.0,
        });
        Curve { cutoff_hz, true_cutoff_hz: 0.9 * cutoff_hz, points: points.collect() }
    }

    fn plot(curves: Vec<Curve>) -> ZwidthPlot {
        ZwidthPlot {
            title: "Z-width \"paper\" & more".to_owned(),
            subtitle: "resolution 1 µm".to_owned(),
            curves,
            ideal_cutoff_hz: Some(300.0),
        }
    }

    fn many(count: u32) -> Vec<Curve> {
        let cutoffs = (1..=count).map(|n| 100.0 * f64::from(n));
        cutoffs.map(|fc| curve(fc, 30.0 * fc, 69)).collect()
    }

    #[test]
    fn it_holds_every_curve_and_names_axes() {
        for count in [1, 12, 30, 80] {
            let plot = plot(many(count));
            let figure = look(zwidth, &plot);
            let svg = figure.svg();
            assert!(svg.contains("Damping B [N s/m]"));
            assert!(svg.contains("Stiffness K [kN/m]"));
            for curve in &plot.curves {
                let name = format!("<title>{} Hz nominal", hertz(curve.cutoff_hz));
                assert_eq!(svg.matches(&name).count(), 1, "{name}");
            }
            assert_eq!(svg.contains("300 ideal"), count >= 3);
        }
    }

    #[test]
    fn nothing_leaves_the_paper() {
        for count in [30, 80] {
            let tree = parse(look(zwidth, &plot(many(count))).svg());
            let drawn = tree.root().abs_bounding_box();
            assert!(drawn.left() >= 0.0 && drawn.top() >= 0.0);
            assert!(drawn.right() <= tree.size().width());
            assert!(drawn.bottom() <= tree.size().height());
        }
    }

    #[test]
    fn empty_boundaries_are_said_to_be_empty() {
        for curves in [vec![], vec![curve(50.0, 0.0, 0), curve(300.0, 0.0, 0)]] {
            let figure = look(zwidth, &plot(curves));
            assert!(figure.svg().contains("no stable wall found"));
        }
        let figure = look(zwidth, &plot(vec![curve(50.0, 0.0, 0), curve(300.0, 9e4, 1)]));
        assert!(figure.svg().contains("50 (none)"));
        assert!(figure.svg().contains("300 ideal"));
        assert!(!figure.svg().contains("no stable wall found"));
    }

    #[test]
    fn soft_walls_are_in_newtons_per_metre() {
        let figure = look(zwidth, &plot(vec![curve(50.0, 900.0, 20)]));
        assert!(figure.svg().contains("Stiffness K [N/m]"));
    }

    #[test]
    fn what_is_no_number_is_an_error() {
        let bad = plot(vec![curve(50.0, f64::NAN, 3)]);
        let quantity = "stiffness_n_per_m";
        assert_eq!(zwidth(&bad), Err(FigureError::NotPlottable { quantity }));
        let quantity = "cutoff_hz";
        let bad = plot(vec![curve(0.0, 1.0, 3)]);
        assert_eq!(zwidth(&bad), Err(FigureError::NotPositive { quantity }));
    }
}
