//! `trade`: compares number formats and forms of the velocity filter, and methods to advance the plant.

use std::fmt::Write as _;

use clap::Args;
use serde::Serialize;

use super::{
    Common, list, progress,
    shared::{Typed, listed},
};
use crate::{
    error::Error,
    interrupt,
    notation::number,
    output::{
        estimated::{marked, print_of},
        figure::hertz,
        manifest::Manifest,
        terminal::headed,
        trade_figures,
    },
    range::within,
    scene::NamedScene,
    simulation::prepared::Numeric,
};
use lab_trade::{
    Bench, Criterion, Format, Variant, cost, default_cutoffs_hz,
    filters::{self, Filters},
    plant::{self, Plants},
    table::{self, GoodFor},
};

/// Measures how fast and how accurate different velocity filters and plant methods are. The filters differ in number
/// format and form. The methods advance the plant by a sample.
#[derive(Debug, Args)]
pub struct TradeArgs {
    /// Built-in scene or scene file.
    scene: String,
    /// Nominal cutoffs of the filters in Hz, A,B,C or FROM:STEP:TO [default: 0.1 Hz to 0.45 of the rate].
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_negative_numbers = true)]
    cutoffs: Option<list::List>,
    /// Walks for each filter and cutoff, with starts spread over one count.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
}

const FILES: &[&str] = &["filters.csv", "plant.csv", "filters", "cutoffs", "plant", "summary.json"];

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    cutoffs_hz: Vec<f64>,
    q15_full_scale_m_per_s: f64,
    filters: Vec<JsonFilter>,
    plant: JsonPlant,
}

#[derive(Serialize)]
struct JsonFilter {
    format: &'static str,
    form: &'static str,
    cycles: Option<f64>,
    ram_bytes: Option<f64>,
    would_do_hz: Option<[f64; 2]>,
    missed_below: Vec<&'static str>,
    missed_above: Vec<&'static str>,
    refused_below: bool,
}

#[derive(Serialize)]
struct JsonPlant {
    cutoff_hz: f64,
    stiffness_n_per_m: f64,
    damping_n_s_per_m: f64,
    verdicts: usize,
    verdicts_chaotic: usize,
    area_chaotic: f64,
    methods: Vec<JsonMethod>,
}

#[derive(Serialize)]
struct JsonMethod {
    method: &'static str,
    setting: Option<f64>,
    operations_per_s: Option<f64>,
    trajectory_error_m: Option<f64>,
    verdicts_wrong: Option<usize>,
    area_change: Option<f64>,
    refused: Option<String>,
}

pub fn run(args: &TradeArgs, common: &Common) -> Result<(), Error> {
    let scene = NamedScene::load(&args.scene)?;
    crate::study::asked::prepare(&scene)?;
    if common.numeric != Numeric::Fixed {
        return Err(Error::input("--numeric: trade runs all formats, allowed fixed"));
    }
    let cutoffs_hz = cutoffs(args, &scene)?;
    let mut to = common.fill(&scene, "trade", FILES)?;
    let filters_done = cutoffs_hz.len() * Variant::ALL.len() * (1 + args.repeat as usize);
    let methods_done = 1 + plant::Method::all(&scene.scene).len();
    let bar = progress::bar((filters_done + methods_done) as u64);
    let done = || bar.inc(1);
    let stop = interrupt::flag();
    let plants = plant::measure(common.engine, &scene.scene, stop, done)
        .map_err(|error| error.of(&scene.name))?;
    let filters = filters::measure(&scene.scene, &cutoffs_hz, args.repeat, stop, done)
        .map_err(|error| error.of(&scene.name))?;
    bar.finish_and_clear();
    let bench = Bench::of(&scene.scene);
    let good = table::good_for(&filters);
    let json = json(&scene, &cutoffs_hz, &bench, &good, &plants);
    to.add("filters.csv", table::filters_csv(&filters, &bench))?;
    to.add("plant.csv", table::plant_csv(&plants))?;
    to.figure("filters", &trade_figures::filters(&scene.name, &filters, &bench)?)?;
    to.figure("cutoffs", &trade_figures::cutoffs(&scene.name, &filters)?)?;
    to.figure("plant", &trade_figures::plants(&scene.name, &plants)?)?;
    to.add("summary.json", headed(marked(&scene.scene, &json))? + "\n")?;
    let command = Typed::new("trade", &scene.name)
        .maybe("cutoffs", args.cutoffs.as_ref().and_then(|cutoffs| listed(&cutoffs.0)))
        .with("repeat", args.repeat);
    let results = to.finish(&Manifest::new(command.0, &scene))?;
    print_of(common.json, &scene.scene, &json, || {
        let filters = filter_text(&filters, &good, &bench);
        format!("{filters}\n{}\n{results}", plant_text(&plants))
    })
}

/// The user's cutoffs, after a check. They are sorted, and each is there once.
fn cutoffs(args: &TradeArgs, scene: &NamedScene) -> Result<Vec<f64>, Error> {
    let rate_hz = scene.scene.control.rate_hz;
    let Some(list::List(asked)) = &args.cutoffs else {
        return Ok(default_cutoffs_hz(rate_hz));
    };
    let range = 1e-5 * rate_hz..=0.499 * rate_hz;
    for &cutoff_hz in asked {
        within("--cutoffs", cutoff_hz, range.clone()).map_err(Error::Input)?;
    }
    Ok(crate::study::sweep::ascending(asked))
}

fn json<'a>(
    scene: &'a NamedScene,
    cutoffs_hz: &[f64],
    bench: &Bench,
    good: &[GoodFor],
    plants: &Plants,
) -> Json<'a> {
    let names = |missed: &[Criterion]| missed.iter().map(|c| c.name()).collect();
    let filters = good.iter().map(|good| {
        let cost = cost::of(good.variant);
        JsonFilter {
            format: good.variant.format.name(),
            form: good.variant.form.name(),
            cycles: cost.map(|cost| cost.cycles),
            ram_bytes: cost.map(|cost| cost.ram_bytes),
            would_do_hz: good.cutoffs_hz,
            missed_below: names(&good.below),
            missed_above: names(&good.above),
            refused_below: good.refused_below,
        }
    });
    let methods = plants.rows.iter().map(|row| {
        let measured = row.measured.as_ref().ok();
        JsonMethod {
            method: row.method.name(),
            setting: row.method.setting(),
            operations_per_s: measured.map(|m| m.operations_per_s),
            trajectory_error_m: measured.map(|m| m.trajectory_m),
            verdicts_wrong: measured.map(|m| m.verdicts_wrong),
            area_change: measured.map(|m| m.area_change),
            refused: row.measured.as_ref().err().cloned(),
        }
    });
    Json {
        scene: &scene.name,
        cutoffs_hz: cutoffs_hz.to_vec(),
        q15_full_scale_m_per_s: bench.q15_full_scale_counts() * bench.m_per_s(),
        filters: filters.collect(),
        plant: JsonPlant {
            cutoff_hz: plants.cutoff_hz,
            stiffness_n_per_m: plants.wall[0],
            damping_n_s_per_m: plants.wall[1],
            verdicts: plants.verdicts,
            verdicts_chaotic: plants.verdicts_chaotic,
            area_chaotic: plants.area_chaotic,
            methods: methods.collect(),
        },
    }
}

/// One line per variant with cost, usable cutoffs, and errors at the other cutoffs. A line has at most 120 columns.
fn filter_text(filters: &Filters, good: &[GoodFor], bench: &Bench) -> String {
    let mut text = String::from(
        "velocity filter              cycles host ns  would do, Hz         misses just beyond",
    );
    let names =
        |missed: &[Criterion]| missed.iter().map(|c| c.name()).collect::<Vec<_>>().join(", ");
    for (good, ns) in good.iter().zip(&filters.host_ns) {
        let cycles = cost::of(good.variant).map_or("-".into(), |cost| number(cost.cycles, 0));
        let range = match good.cutoffs_hz {
            None => "nowhere".into(),
            Some([low, high]) => format!("{} to {}", hertz(low), hertz(high)),
        };
        let mut beyond = vec![];
        match (good.cutoffs_hz, good.refused_below) {
            (None, true) => beyond.push("refused".into()),
            (None, false) => beyond.push(names(&good.below)),
            (_, true) => beyond.push("below: refused".into()),
            (_, false) if !good.below.is_empty() => {
                beyond.push(format!("below: {}", names(&good.below)));
            }
            _ => {}
        }
        if !good.above.is_empty() {
            beyond.push(format!("above: {}", names(&good.above)));
        }
        let name = good.variant.to_string();
        let beyond = beyond.join("; ");
        let _ = write!(text, "\n{name:<28} {cycles:>6} {ns:>7.2}  {range:<20} {beyond}");
    }
    let _ = write!(
        text,
        "\ntried: {} cutoffs from {} to {} Hz; {} has a full scale of {} m/s\n",
        filters.exact.len(),
        filters.exact.first().map_or(String::new(), |exact| hertz(exact.cutoff_hz)),
        filters.exact.last().map_or(String::new(), |exact| hertz(exact.cutoff_hz)),
        Format::Q15.name(),
        bench.q15_full_scale_counts() * bench.m_per_s()
    );
    text
}

fn plant_text(plants: &Plants) -> String {
    let mut text = String::from(
        "plant                 setting   operations/s  host ns  trajectory, m  verdicts      area, %",
    );
    for row in &plants.rows {
        let setting = row.method.setting().map_or(String::new(), |value| {
            if value < 1.0 { format!("{value:e}") } else { value.to_string() }
        });
        let _ = write!(text, "\n{:<20} {setting:>8} ", row.method.name());
        let _ = match &row.measured {
            Ok(m) => write!(
                text,
                "{:>14.3e} {:>8.1} {:>14.1e} {:>9} {:>12}",
                m.operations_per_s,
                m.host_ns,
                m.trajectory_m,
                format!("{}/{}", m.verdicts_wrong, plants.verdicts),
                number(100.0 * m.area_change, 3)
            ),
            // the reason may be long, so it is only in plant.csv
            Err(_) => write!(text, "refused, see plant.csv"),
        };
    }
    let _ = write!(
        text,
        "\nverdicts and area are chaotic: the reference's own, its start moved by {} count, change by {}/{} and {} %",
        plant::NUDGE_COUNTS,
        plants.verdicts_chaotic,
        plants.verdicts,
        number(100.0 * plants.area_chaotic, 3)
    );
    text
}
