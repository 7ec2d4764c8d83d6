//! The report of a sweep: one HTML file that needs no other file.
//!
//! Style sheet and figures are inline, without scripts or external references. The page fits on a phone, prints in
//! black on white, and follows the reader's light or dark setting. Figures stay on white, because colours show the
//! order of cutoffs.

use std::fmt::Write as _;

use super::figure::{AreaPoint, Figure, escape, hertz, scaled_unit};
use crate::{notation::number, scene::Units};

const STYLE: &str = "\
:root{color-scheme:light dark;--text:#1a1a1a;--quiet:#5a5a5a;--page:#fff;--line:#d0d0d0;--box:#f5f5f5;--accent:#a84a00}
@media(prefers-color-scheme:dark){:root{--text:#e8e8e8;--quiet:#a8a8a8;--page:#16181b;--line:#3a3d42;--box:#212428;--accent:#ff9a4d}}
*{box-sizing:border-box}
body{margin:0 auto;max-width:56rem;padding:1.5rem 1rem 3rem;font:1rem/1.55 system-ui,sans-serif;color:var(--text);background:var(--page)}
header p{margin:0;color:var(--quiet)}
h1{margin:.3rem 0 1rem;font-size:1.6rem;line-height:1.25}
h2{margin:2.2rem 0 .6rem;font-size:1.15rem}
figure{margin:1.2rem 0}
figure svg{display:block;width:100%;height:auto;background:#fff;border:1px solid var(--line);border-radius:4px}
figcaption{margin-top:.4rem;font-size:.9rem;color:var(--quiet)}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.9rem;font-variant-numeric:tabular-nums}
th,td{padding:.3rem .7rem;border-bottom:1px solid var(--line);text-align:right;vertical-align:bottom}
thead th{border-bottom:2px solid var(--quiet);font-weight:600}
th small{font-weight:400;color:var(--quiet);white-space:nowrap}
.range{background:var(--box)}
.ideal{color:var(--accent);font-weight:600}
.facts th{text-align:left;font-weight:400;color:var(--quiet)}
.facts td{text-align:left;overflow-wrap:anywhere}
pre{margin:0;padding:.8rem 1rem;overflow-x:auto;font-size:.82rem;line-height:1.45;background:var(--box);border:1px solid var(--line);border-radius:4px}
@media print{:root{color-scheme:light;--text:#000;--quiet:#444;--page:#fff;--line:#bbb;--box:#fff;--accent:#000}body{max-width:none;padding:0;font-size:10pt}figure,tr{break-inside:avoid}h2{break-after:avoid}pre{white-space:pre-wrap}.wide{overflow:visible}}
";

#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Scene and resolution: the small line above the answer, and the title of the page.
    pub title: String,
    /// Smallest nominal cutoff that is as good as the best cutoff. `None` if no wall was stable.
    pub ideal_cutoff_hz: Option<f64>,
    /// First and last nominal cutoff that the repeats cannot distinguish from the ideal cutoff.
    pub ideal_cutoff_range_hz: Option<[f64; 2]>,
    /// The recommended cutoff as the answer. If it is `None`, the ideal cutoff is the answer.
    pub answer: Option<String>,
    pub figures: Vec<ReportFigure>,
    pub units: Units,
    pub areas: Vec<AreaPoint>,
    /// Further results: a heading, and lines of text. Empty texts are left out.
    pub texts: Vec<(&'static str, String)>,
    pub notes: Vec<String>,
    pub scene: String,
    /// Where the report comes from, as names and values: version, toolchain, command.
    pub provenance: Vec<(String, String)>,
}

/// A figure, and the sentence below it.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportFigure {
    pub figure: Figure,
    pub caption: String,
}

#[must_use]
pub fn html(report: &Report) -> String {
    let mut sections = vec![("Areas", areas(report))];
    sections.extend(report.texts.iter().map(|(heading, text)| (*heading, scene(text))));
    sections.extend([
        ("Notes", notes(&report.notes)),
        ("Scene", scene(&report.scene)),
        ("Provenance", provenance(&report.provenance)),
    ]);
    page(&report.title, &answer(report), &report.figures, &sections)
}

/// One HTML file: a small line, the answer, figures, sections. Empty sections are left out.
pub(crate) fn page(
    title: &str,
    answer: &str,
    figures: &[ReportFigure],
    sections: &[(&str, String)],
) -> String {
    let mut out = String::new();
    let title = escape(title);
    let _ = write!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <header>\n<p>{title}</p>\n<h1>{}</h1>\n</header>\n<main>\n",
        escape(answer)
    );
    for ReportFigure { figure, caption } in figures {
        let _ = write!(
            out,
            "<figure>\n{}<figcaption>{}</figcaption>\n</figure>\n",
            figure.svg(),
            escape(caption)
        );
    }
    for (heading, content) in sections {
        section(&mut out, heading, content);
    }
    out.push_str("</main>\n</body>\n</html>\n");
    out
}

/// The result as one sentence, with the range first.
fn answer(report: &Report) -> String {
    if let Some(answer) = &report.answer {
        return answer.clone();
    }
    let range = report.ideal_cutoff_range_hz.map(|[low, high]| {
        if low == high {
            format!("Ideal cutoff range: {} Hz only", hertz(low))
        } else {
            format!("Ideal cutoff range: {} to {} Hz", hertz(low), hertz(high))
        }
    });
    let ideal =
        report.ideal_cutoff_hz.map(|ideal| format!("deal cutoff {} Hz (nominal)", hertz(ideal)));
    match (range, ideal) {
        (Some(range), Some(ideal)) => format!("{range}; i{ideal}"),
        (None, Some(ideal)) => format!("I{ideal}"),
        (Some(range), None) => format!("{range} (nominal)"),
        (None, None) => "No stable wall found at any cutoff".to_owned(),
    }
}

/// A section with a heading. Empty content gives no section.
fn section(out: &mut String, heading: &str, content: &str) {
    if !content.is_empty() {
        let _ = write!(out, "<section>\n<h2>{heading}</h2>\n{content}</section>\n");
    }
}

fn areas(report: &Report) -> String {
    if report.areas.is_empty() {
        return String::new();
    }
    let largest = report.areas.iter().map(|row| row.area_high.max(row.area)).fold(0.0, f64::max);
    let (unit, area_times) = report.units.written("N² s/m²");
    let (factor, unit) = scaled_unit(largest * area_times, unit);
    let factor = factor / area_times;
    let ((k_unit, k_times), (b_unit, b_times)) =
        (report.units.written("N/m"), report.units.written("N s/m"));
    let digits = if report.units.is_rotary() { 4 } else { 0 };
    let columns = [
        ("Cutoff, nominal", "Hz"),
        ("True −3 dB", "Hz"),
        ("Mean area", unit.as_str()),
        ("Lowest", unit.as_str()),
        ("Highest", unit.as_str()),
        ("Peak K", k_unit),
        ("Largest B", b_unit),
    ];
    let rows = report.areas.iter().map(|row| {
        let cells = vec![
            hertz(row.cutoff_hz),
            hertz(row.true_cutoff_hz),
            number(row.area / factor, 3),
            number(row.area_low / factor, 3),
            number(row.area_high / factor, 3),
            number(row.stiffness_peak_n_per_m * k_times, digits),
            number(row.damping_max_n_s_per_m * b_times, digits),
        ];
        (row_class(report, row.cutoff_hz), cells)
    });
    table(&columns, rows)
}

/// A table. Each column has a unit. Each row has a class attribute and cells.
pub(crate) fn table(
    columns: &[(&str, &str)],
    rows: impl Iterator<Item = (&'static str, Vec<String>)>,
) -> String {
    let mut out = String::from("<div class=\"wide\">\n<table>\n<thead>\n<tr>");
    for (name, unit) in columns {
        let _ = write!(out, "<th scope=\"col\">{name}<br><small>[{unit}]</small></th>");
    }
    out.push_str("</tr>\n</thead>\n<tbody>\n");
    for (class, cells) in rows {
        let _ = write!(out, "<tr{class}>");
        for cell in cells {
            let _ = write!(out, "<td>{}</td>", escape(&cell));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody>\n</table>\n</div>\n");
    out
}

fn row_class(report: &Report, cutoff_hz: f64) -> &'static str {
    let inside =
        report.ideal_cutoff_range_hz.is_some_and(|[low, high]| (low..=high).contains(&cutoff_hz));
    match (report.ideal_cutoff_hz == Some(cutoff_hz), inside) {
        (true, true) => " class=\"range ideal\"",
        (true, false) => " class=\"ideal\"",
        (false, true) => " class=\"range\"",
        (false, false) => "",
    }
}

pub(crate) fn notes(notes: &[String]) -> String {
    if notes.is_empty() {
        return String::new();
    }
    let items: String = notes.iter().map(|note| format!("<li>{}</li>\n", escape(note))).collect();
    format!("<ul>\n{items}</ul>\n")
}

pub(crate) fn scene(scene: &str) -> String {
    if scene.is_empty() {
        return String::new();
    }
    // A browser ignores the first line break after <pre>.
    format!("<pre>\n{}</pre>\n", escape(scene))
}

pub(crate) fn provenance(facts: &[(String, String)]) -> String {
    if facts.is_empty() {
        return String::new();
    }
    let rows: String = facts
        .iter()
        .map(|(name, value)| {
            format!("<tr><th scope=\"row\">{}</th><td>{}</td></tr>\n", escape(name), escape(value))
        })
        .collect();
    format!("<table class=\"facts\">\n<tbody>\n{rows}</tbody>\n</table>\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::figure::{AreaPlot, ZwidthPlot, area, zwidth};

    fn row(cutoff_hz: f64, area: f64) -> AreaPoint {
        AreaPoint {
            cutoff_hz,
            true_cutoff_hz: 0.9 * cutoff_hz,
            area,
            area_low: 0.99 * area,
            area_high: 1.01 * area,
            stiffness_peak_n_per_m: 96_000.0,
            damping_max_n_s_per_m: 760.0,
        }
    }

    fn report() -> Report {
        let boundaries = ZwidthPlot {
            units: Units::Linear,
            title: "Z-width".to_owned(),
            subtitle: String::new(),
            marked: "ideal",
            legend: String::new(),
            curves: vec![],
        };
        let areas = AreaPlot {
            units: Units::Linear,
            title: "Area".to_owned(),
            subtitle: String::new(),
            points: vec![],
            ideal_cutoff_hz: None,
            ideal_range_hz: None,
            names: AreaPlot::IDEAL,
            convention: String::new(),
        };
        let figures = [zwidth(&boundaries).unwrap(), area(&areas).unwrap()];
        Report {
            units: Units::Linear,
            title: "paper-1um <test>".to_owned(),
            ideal_cutoff_hz: Some(1200.0),
            ideal_cutoff_range_hz: Some([1200.0, 1700.0]),
            answer: None,
            figures: figures
                .into_iter()
                .map(|figure| ReportFigure { figure, caption: "K & B".to_owned() })
                .collect(),
            areas: vec![row(500.0, 2.65e7), row(1200.0, 4.17e7), row(1700.0, 4.55e7)],
            texts: vec![("Limits", "1 um".to_owned()), ("How sure", String::new())],
            notes: vec!["a < b".to_owned()],
            scene: "[device]\nname = \"<script>\"\n".to_owned(),
            provenance: vec![("version".to_owned(), "0.1.0 & more".to_owned())],
        }
    }

    #[test]
    fn the_answer_comes_first() {
        let page = html(&report());
        let heading =
            "<h1>Ideal cutoff range: 1200 to 1700 Hz; ideal cutoff 1200 Hz (nominal)</h1>";
        assert!(page.find(heading).unwrap() < page.find("<svg").unwrap());
        assert_eq!(page, html(&report()));
    }

    #[test]
    fn the_page_needs_nothing_else_and_runs_nothing() {
        let page = html(&report());
        for forbidden in ["<script", "href=", "src=", "@import", "url(", " id="] {
            assert!(!page.contains(forbidden), "{forbidden} is in the page");
        }
        assert_eq!(page.matches("<svg").count(), 2);
    }

    #[test]
    fn text_is_escaped_and_elements_close() {
        let page = html(&report());
        assert!(page.contains("<title>paper-1um &lt;test&gt;</title>"));
        assert!(page.contains("name = &quot;&lt;script&gt;&quot;"));
        assert!(page.contains("<li>a &lt; b</li>"));
        assert!(page.contains("<td>0.1.0 &amp; more</td>"));
        for element in ["section", "figure", "table", "tr", "th", "td", "pre", "main"] {
            let opened = page.matches(&format!("<{element}>")).count()
                + page.matches(&format!("<{element} ")).count();
            let closed = page.matches(&format!("</{element}>")).count();
            assert_eq!(opened, closed, "{element}");
        }
    }

    #[test]
    fn the_table_marks_the_ideal_range() {
        let page = html(&report());
        assert!(page.contains("<tr><td>500</td><td>450</td><td>2.650</td>"));
        assert!(page.contains("<tr class=\"range ideal\"><td>1200</td>"));
        assert!(page.contains("<tr class=\"range\"><td>1700</td>"));
        assert!(page.contains("[10⁷ N² s/m²]"));
        assert!(page.contains("<td>96\u{2009}000</td><td>760</td>"));
    }

    #[test]
    fn a_sweep_without_a_stable_wall_says_so() {
        let mut empty = report();
        empty.ideal_cutoff_hz = None;
        empty.ideal_cutoff_range_hz = None;
        empty.areas.clear();
        empty.notes.clear();
        let page = html(&empty);
        assert!(page.contains("<h1>No stable wall found at any cutoff</h1>"));
        assert!(!page.contains("<h2>Areas</h2>") && !page.contains("<h2>Notes</h2>"));
    }

    #[test]
    fn one_cutoff_is_not_called_a_range_of_two() {
        let mut lone = report();
        lone.ideal_cutoff_range_hz = Some([1200.0, 1200.0]);
        assert!(html(&lone).contains("Ideal cutoff range: 1200 Hz only; ideal cutoff 1200 Hz"));
    }
}
