//! The Z-width figure: stiffness over damping, with one boundary per curve.

use plotters::{prelude::*, style::text_anchor::HPos};

use super::{
    Figure, FigureError, MARGIN, Page, WIDTH,
    axis::{Ticks, hertz},
    colour::{ACCENT, QUIET, TEXT, ordered},
    grid, not_negative,
    panel::{self, AXIS_TITLE_SIZE, Grid, Panel, SMALL_SIZE, X_TITLE_DROP, stroke},
    render, text,
};
use crate::{scene::Units, study::boundary::BoundaryPoint};

const HEIGHT: f64 = 400.0;
const LEFT: f64 = 64.0;
const TOP: f64 = 58.0;
const BOTTOM: f64 = HEIGHT - 50.0;
const MOST_TICKS: usize = 9;
/// Smallest end of the axis, as a multiple of the highest peak. The space above the peak is for the halo of the ideal
/// curve.
const HEADROOM: f64 = 1.02;
/// Stiffness from which on the axis is in kN/m.
const KILO_FROM_N_PER_M: f64 = 2e3;
/// Stiffness from which on the axis is in MN/m.
const MEGA_FROM_N_PER_M: f64 = 2e6;

const CURVE_WIDTH: f64 = 1.4;
const IDEAL_WIDTH: f64 = 2.4;
const IDEAL_HALO: f64 = 4.0;
const DOT_RADIUS: f64 = 1.9;
const IDEAL_DOT_RADIUS: f64 = 2.6;
/// Smallest mean distance between the points of a curve that is drawn with dots.
const DOT_SPACING: f64 = 4.0;
/// Number of curves from which on dots are smaller, by the factor [`CROWD_SHARE`].
const CROWD: usize = 16;
const CROWD_SHARE: f64 = 0.7;

const LEGEND_PITCH: f64 = 17.0;
const LEGEND_GAP: f64 = 14.0;
const LEGEND_SWATCH: f64 = 20.0;
const LEGEND_SWATCH_GAP: f64 = 6.0;
const LEGEND_TITLE_MIDDLE: f64 = TOP + 5.5;
const LEGEND_FIRST_MIDDLE: f64 = TOP + 28.0;
const LEGEND_ROWS: usize = 17;
const LEGEND_COLUMNS: usize = 2;
const NOTE_DROP: f64 = 33.0;

#[derive(Debug, Clone, PartialEq)]
pub struct ZwidthPlot {
    pub title: String,
    /// The second line: scene, resolution, and other facts that identify the run.
    pub subtitle: String,
    pub units: Units,
    pub legend: String,
    /// The word that the legend adds to the ideal curve, for example `ideal`.
    pub marked: &'static str,
    /// The boundaries. Their order determines their colours.
    pub curves: Vec<Curve>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    pub name: String,
    /// Text that a browser shows under the pointer.
    pub detail: String,
    /// Whether the curve is drawn last, in the accent colour.
    pub ideal: bool,
    /// The boundary, in the order of the walk. It is empty if no wall was stable.
    pub points: Vec<BoundaryPoint>,
}

impl Curve {
    /// Title of the legend if the curves are named after their cutoffs.
    pub const CUTOFF_LEGEND: &str = "Cutoff [Hz]";

    /// The boundary of one nominal cutoff. The filter's gain is -3 dB at `true_cutoff_hz`.
    pub fn of_cutoff(
        cutoff_hz: f64,
        true_cutoff_hz: f64,
        ideal: bool,
        points: Vec<BoundaryPoint>,
    ) -> Self {
        let name = hertz(cutoff_hz);
        let detail = format!("{name} Hz nominal, −3 dB at {} Hz", hertz(true_cutoff_hz));
        Self { name, detail, ideal, points }
    }
}

/// Draws stiffness over damping, and a legend of the curves. Both axes start at 0.
///
/// With more than 34 curves, the legend only names every second, third, .. curve. The legend always names the ideal
/// curve.
///
/// # Errors
/// [`FigureError`] if a number is NaN, infinite or negative.
pub fn zwidth(plot: &ZwidthPlot) -> Result<Figure, FigureError> {
    largest(plot)?;
    let mut figure = Figure::new([&plot.title, &plot.subtitle], HEIGHT, &|page| draw(plot, page))?;
    for (curve, style) in plot.curves.iter().zip(styles(plot)) {
        if !curve.points.is_empty() {
            let width = stroke(style.width());
            render::name_line(&mut figure.svg, style.colour, width, &curve.detail);
        }
    }
    Ok(figure)
}

fn draw(plot: &ZwidthPlot, page: &Page) -> Result<(), FigureError> {
    let [largest_damping, largest_stiffness] = largest(plot)?;
    let (unit, factor) = match largest_stiffness {
        _ if plot.units.is_rotary() => {
            let (unit, times) = plot.units.written("N/m");
            (unit, 1.0 / times)
        }
        k if k < KILO_FROM_N_PER_M => ("N/m", 1.0),
        k if k < MEGA_FROM_N_PER_M => ("kN/m", 1e3),
        _ => ("MN/m", 1e6),
    };
    let (damping_unit, damping_times) = plot.units.written("N s/m");
    let legend = Legend::of(plot);
    let panel =
        Panel { left: LEFT, top: TOP, right: WIDTH - MARGIN - legend.width(), bottom: BOTTOM };
    let mut x = Ticks::around(0.0, largest_damping * damping_times, MOST_TICKS);
    let mut y = Ticks::around(0.0, HEADROOM * largest_stiffness / factor, MOST_TICKS);
    let empty = plot.curves.iter().all(|curve| curve.points.is_empty());
    if empty {
        (x, y) = (x.bare(), y.bare());
        panel.remark(page, "no stable wall found")?;
    }
    let mut chart = panel.chart(page, x, y, X_TITLE_DROP)?;
    let titles = [&*format!("Damping B [{damping_unit}]"), &format!("Stiffness K [{unit}]")];
    panel::axes(&mut chart, Grid::Both, titles)?;
    panel.frame(page)?;

    // The ideal curve is drawn last, over the other curves.
    let styles = styles(plot);
    for on_top in [false, true] {
        for (curve, style) in plot.curves.iter().zip(&styles) {
            if style.ideal == on_top {
                let place = |point: &BoundaryPoint| {
                    let stiffness = point.stiffness_n_per_m / factor;
                    chart.backend_coord(&(point.damping_n_s_per_m * damping_times, stiffness))
                };
                draw_curve(page, curve.points.iter().map(place).collect(), *style)?;
            }
        }
    }
    legend.draw(page, panel.right + LEGEND_GAP)
}

/// Largest damping and largest stiffness of all curves. Each is at least 1, so that its axis has a length.
fn largest(plot: &ZwidthPlot) -> Result<[f64; 2], FigureError> {
    let mut largest = [0.0_f64; 2];
    for curve in &plot.curves {
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
    colour: RGBColor,
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
        let ideal = curve.ideal;
        let colour = if ideal { ACCENT } else { ordered(index, count) };
        let crowded = count >= CROWD;
        Style { colour, ideal, crowded }
    };
    plot.curves.iter().enumerate().map(style).collect()
}

fn draw_curve(page: &Page, points: Vec<(i32, i32)>, style: Style) -> Result<(), FigureError> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return Ok(());
    };
    let gaps = (points.len() - 1) as f64;
    let dotted = f64::from((last.0 - first.0).abs()) >= gaps * f64::from(grid(DOT_SPACING));
    if style.ideal {
        panel::path(page, points.clone(), WHITE, IDEAL_HALO)?;
    }
    panel::path(page, points.clone(), style.colour, style.width())?;
    if dotted {
        for point in points {
            let dot = Circle::new(point, grid(style.radius()), style.colour.filled());
            page.draw(&dot)?;
        }
    }
    Ok(())
}

struct Legend {
    title: String,
    entries: Vec<(String, Style)>,
    /// The legend names every curve with an index that is a multiple of this number.
    every: usize,
    columns: usize,
    column_width: f64,
}

impl Legend {
    fn of(plot: &ZwidthPlot) -> Self {
        let every = plot.curves.len().div_ceil(LEGEND_ROWS * LEGEND_COLUMNS).max(1);
        let named = |(index, (curve, style)): (usize, (&Curve, Style))| {
            let mut text = curve.name.clone();
            if curve.points.is_empty() {
                text.push_str(" (none)");
            } else if style.ideal && !plot.marked.is_empty() {
                text.push(' ');
                text.push_str(plot.marked);
            }
            (style.ideal || index.is_multiple_of(every)).then_some((text, style))
        };
        let entries: Vec<_> =
            plot.curves.iter().zip(styles(plot)).enumerate().filter_map(named).collect();
        let widest =
            entries.iter().map(|(text, _)| text::width(text, SMALL_SIZE)).fold(0.0, f64::max);
        Self {
            title: plot.legend.clone(),
            columns: entries.len().div_ceil(LEGEND_ROWS),
            column_width: LEGEND_SWATCH + LEGEND_SWATCH_GAP + widest + LEGEND_GAP,
            entries,
            every,
        }
    }

    fn width(&self) -> f64 {
        let titles = text::width(&self.title, AXIS_TITLE_SIZE) + LEGEND_GAP;
        (self.columns as f64 * self.column_width).max(titles)
    }

    fn draw(&self, page: &Page, left: f64) -> Result<(), FigureError> {
        let write =
            |text: &str, at, size, colour| text::write(page, text, at, HPos::Left, size, colour);
        let title = [left, LEGEND_TITLE_MIDDLE];
        write(&self.title, title, AXIS_TITLE_SIZE, TEXT)?;
        let rows = self.entries.len().div_ceil(self.columns.max(1)).max(1);
        for (index, (text, style)) in self.entries.iter().enumerate() {
            let x = left + (index / rows) as f64 * self.column_width;
            let y = LEGEND_FIRST_MIDDLE + (index % rows) as f64 * LEGEND_PITCH;
            if !text.ends_with(')') {
                let swatch = [[x, y], [x + LEGEND_SWATCH, y]];
                panel::line(page, &swatch, style.colour, style.width())?;
                let middle = [x + LEGEND_SWATCH / 2.0, y];
                panel::dot(page, middle, style.radius(), style.colour)?;
            }
            let colour = if style.ideal { ACCENT } else { TEXT };
            let beside = [x + LEGEND_SWATCH + LEGEND_SWATCH_GAP, y];
            write(text, beside, SMALL_SIZE, colour)?;
        }
        if self.every > 1 {
            let note = format!("1 in {} named", self.every);
            write(&note, [left, BOTTOM + NOTE_DROP], SMALL_SIZE, QUIET)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::figure::testing::{Pixels, check as look};

    fn curve(cutoff_hz: f64, stiffness_n_per_m: f64, points: u32) -> Curve {
        let points = (1..=points).map(|n| BoundaryPoint {
            damping_n_s_per_m: 10.0 * f64::from(n),
            stiffness_n_per_m: stiffness_n_per_m * f64::from(n.min(70 - n) + 1) / 36.0,
        });
        Curve::of_cutoff(cutoff_hz, 0.9 * cutoff_hz, cutoff_hz == 300.0, points.collect())
    }

    fn plot(curves: Vec<Curve>) -> ZwidthPlot {
        ZwidthPlot {
            units: Units::Linear,
            title: "Z-width \"paper\" & more".to_owned(),
            subtitle: "resolution 1 µm".to_owned(),
            marked: "ideal",
            legend: Curve::CUTOFF_LEGEND.into(),
            curves,
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
                let name = format!("<title>{} Hz nominal", curve.name);
                assert_eq!(svg.matches(&name).count(), 1, "{name}");
            }
            assert_eq!(svg.contains("300 ideal"), count >= 3);
        }
    }

    #[test]
    fn the_bitmap_shows_the_ideal_curve_where_it_is() {
        let figure = look(zwidth, &plot(vec![curve(300.0, 36_000.0, 69)]));
        let pixels = Pixels::of(&figure);
        assert!(pixels.count(ACCENT) > 1000);
        // The peak of 36 kN/m is at 350 N s/m, in the middle between 0 and 700. The axis ends at 40 kN/m.
        let right = WIDTH - MARGIN - Legend::of(&plot(vec![curve(300.0, 1.0, 1)])).width();
        let peak = BOTTOM - 0.9 * (BOTTOM - TOP);
        assert_eq!(pixels.at(f64::midpoint(LEFT, right), peak), [213, 94, 0]);
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
        assert_eq!(
            zwidth(&bad),
            Err(FigureError::of(quantity, crate::output::figure::NOT_PLOTTABLE))
        );
    }
}
