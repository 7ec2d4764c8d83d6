//! `compare`: every velocity estimator on the same boundary.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use serde::Serialize;
use zwidth::velocity::EstimatorName;

use super::{Common, NumericArg, SCHEMA_VERSION, STOP, print_json, print_text, progress};
use crate::{
    compare::{
        Compared, Entry, Place, compare,
        search::{Budget, MISTUNED_BY},
        table::{self, CRITERIA, Winner},
    },
    error::Error,
    figure::{self, Curve, Figure, ZwidthPlot, number},
    manifest::Manifest,
    output::{self, MANIFEST, Staging},
    report::{self, ReportFigure},
    scene::{NamedScene, refused},
};

/// Compares velocity estimators, each tuned by the same search: Z-width, delay, noise, roughness,
/// fidelity, cost.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Built-in scene or scene file; its own estimator does not matter.
    scene: String,
    /// Estimators, A,B,C [default: all].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    estimators: Vec<String>,
    /// B at which K is read off and contacts are compared, N s/m.
    #[arg(long, value_name = "N_S_PER_M", default_value_t = 100.0)]
    damping: f64,
    /// Walks that the search may make for each estimator.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(3..=1000))]
    budget: u32,
    /// Walks at the result of each search, their starts spread over one count.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
}

/// Every file of a result.
const FILES: [&str; 7] = [
    "compare.csv",
    "tuning.csv",
    "boundary.csv",
    "zwidth.svg",
    "zwidth.png",
    "report.html",
    MANIFEST,
];

#[derive(Serialize)]
struct Json<'a> {
    schema_version: u32,
    command: &'static str,
    scene: &'a str,
    damping_n_s_per_m: f64,
    stiffness_n_per_m: f64,
    estimators: Vec<JsonRow>,
    winners: Vec<Winner>,
}

#[derive(Serialize)]
struct JsonRow {
    estimator: String,
    tuning: Option<f64>,
    tuning_unit: Option<&'static str>,
    tuning_at_edge: bool,
    stable_at_wall: bool,
    #[serde(flatten)]
    criteria: serde_json::Map<String, serde_json::Value>,
}

pub fn run(args: &CompareArgs, common: &Common) -> Result<(), Error> {
    let scene = NamedScene::load(&args.scene)?;
    if !matches!(common.numeric, NumericArg::Fixed) {
        return Err(Error::input(
            "--numeric: compare runs the fixed-point core only, allowed fixed",
        ));
    }
    let entries = entries(&args.estimators, &scene)?;
    let plan = scene.scene.walk_plan();
    let range = plan.damping_start_n_s_per_m..=plan.damping_max_n_s_per_m;
    if !range.contains(&args.damping) {
        return Err(Error::Input(refused("--damping", args.damping, &range)));
    }
    let default = || PathBuf::from("zwidth-out").join(&scene.name).join("compare");
    let folder = common.out.clone().unwrap_or_else(default);
    let staging = Staging::new(&folder, &FILES, common.force)?;
    let budget = Budget { walks: args.budget, repeats: args.repeat };
    let each = u64::from(budget.walks) + u64::from(budget.repeats) + 2;
    let bar = progress::bar(entries.len() as u64 * each);
    let (place, compared) =
        compare(&scene.scene, &entries, args.damping, budget, &STOP, || bar.inc(1))?;
    bar.finish_and_clear();
    let winners = table::winners(&compared, &place);
    let manifest = Manifest::new(SCHEMA_VERSION, command_line(args, &scene), &scene);
    write(staging, &scene, &compared, &place, &winners, &manifest)?;
    if common.json {
        let estimators = compared.iter().map(|c| json_row(c, &place)).collect();
        return print_json(&Json {
            schema_version: SCHEMA_VERSION,
            command: "compare",
            scene: &scene.name,
            damping_n_s_per_m: place.damping_n_s_per_m,
            stiffness_n_per_m: place.stiffness_n_per_m,
            estimators,
            winners,
        });
    }
    let mut text = text_table(&compared, &place);
    for winner in &winners {
        let _ = writeln!(text, "{}", sentence(winner));
    }
    let _ = write!(text, "{}\nresults in {}", table::roughness_note(&place), folder.display());
    print_text(&text)
}

/// The estimators of the command line, butterworth first: it gives the wall to compare at.
fn entries(asked: &[String], scene: &NamedScene) -> Result<Vec<Entry>, Error> {
    let all = Entry::all(&scene.scene);
    if asked.is_empty() {
        return Ok(all);
    }
    let mut entries = vec![];
    for name in asked {
        let found = EstimatorName::of_text(name.as_bytes()).ok_or_else(|| {
            let names: Vec<&str> = EstimatorName::ALL.iter().map(|name| name.text()).collect();
            Error::Input(format!("--estimators: {name} is unknown, allowed {}", names.join(", ")))
        })?;
        if !all.contains(&Entry::Tuned(found)) {
            let reason = if found.text().ends_with("prewarped") {
                "differs from the one without pre-warping by its cutoff only".to_owned()
            } else {
                format!("needs a table [accelerometer], which {} has not", scene.name)
            };
            return Err(Error::Input(format!("--estimators: {name} {reason}")));
        }
        if !entries.contains(&Entry::Tuned(found)) {
            entries.push(Entry::Tuned(found));
        }
    }
    entries.sort_by_key(|entry| *entry != Entry::Tuned(EstimatorName::Butterworth));
    Ok(entries)
}

fn command_line(args: &CompareArgs, scene: &NamedScene) -> String {
    let estimators = match args.estimators.is_empty() {
        true => String::new(),
        false => format!(" --estimators {}", args.estimators.join(",")),
    };
    format!(
        "compare {}{estimators} --damping {} --budget {} --repeat {}",
        scene.name, args.damping, args.budget, args.repeat
    )
}

fn write(
    mut staging: Staging,
    scene: &NamedScene,
    compared: &[Compared],
    place: &Place,
    winners: &[Winner],
    manifest: &Manifest,
) -> Result<(), Error> {
    let figure = zwidth(scene, compared)?;
    staging.write("compare.csv", table::csv(compared, place).as_bytes())?;
    staging.write("tuning.csv", tuning_csv(compared).as_bytes())?;
    staging.write("boundary.csv", boundary_csv(compared).as_bytes())?;
    staging.write("zwidth.svg", figure.svg().as_bytes())?;
    staging.write("zwidth.png", &output::png(&figure)?)?;
    staging
        .write("report.html", page(scene, compared, place, winners, figure, manifest).as_bytes())?;
    let json = serde_json::to_vec_pretty(manifest)
        .map_err(|error| Error::Internal(format!("cannot write JSON: {error}")))?;
    staging.write(MANIFEST, &json)?;
    staging.commit()
}

fn tuning(c: &Compared) -> String {
    match c.settings.tuning() {
        None => String::new(),
        Some((parameter, value)) => format!("{} {}", number(value, 1), parameter.unit),
    }
}

fn zwidth(scene: &NamedScene, compared: &[Compared]) -> Result<Figure, Error> {
    let best = compared.iter().map(|c| c.tuned.area()).fold(0.0, f64::max);
    let curves = compared.iter().map(|c| Curve {
        name: c.entry.name(),
        detail: format!("{}, {}", c.entry.name(), tuning(c)),
        ideal: c.tuned.area() == best,
        points: c.tuned.boundaries.first().map(|first| first.points.clone()).unwrap_or_default(),
    });
    figure::zwidth(&ZwidthPlot {
        title: format!("Z-width by estimator, {}", scene.name),
        subtitle: "each at the tuning with the largest area".into(),
        legend: "Estimator".into(),
        curves: curves.collect(),
    })
    .map_err(|error| Error::Internal(format!("cannot draw: {error}")))
}

/// Every tuning that was tried.
fn tuning_csv(compared: &[Compared]) -> String {
    let mut text = String::from("estimator,tuning,tuning_unit,area_n2_s_per_m2\n");
    for c in compared {
        let unit = c.settings.tuning().map_or("", |(parameter, _)| parameter.unit);
        for (value, area) in &c.tuned.tried {
            let _ = writeln!(text, "{},{value},{unit},{area}", c.entry.name());
        }
    }
    text
}

fn boundary_csv(compared: &[Compared]) -> String {
    let mut text = String::from("estimator,repeat,damping_n_s_per_m,stiffness_n_per_m\n");
    for c in compared {
        for (repeat, boundary) in c.tuned.boundaries.iter().enumerate() {
            for point in &boundary.points {
                let (b, k) = (point.damping_n_s_per_m, point.stiffness_n_per_m);
                let _ = writeln!(text, "{},{repeat},{b},{k}", c.entry.name());
            }
        }
    }
    text
}

fn json_row(c: &Compared, place: &Place) -> JsonRow {
    let criteria = CRITERIA.iter().map(|criterion| {
        (criterion.key.to_owned(), serde_json::json!((criterion.value)(c, place)))
    });
    JsonRow {
        estimator: c.entry.name(),
        tuning: c.settings.tuning().map(|(_, value)| value),
        tuning_unit: c.settings.tuning().map(|(parameter, _)| parameter.unit),
        tuning_at_edge: c.tuned.at_edge,
        stable_at_wall: c.contact.stable,
        criteria: criteria.collect(),
    }
}

fn cells(c: &Compared, place: &Place) -> Vec<String> {
    CRITERIA
        .iter()
        .map(|criterion| match (criterion.value)(c, place) {
            None => "-".into(),
            Some(value) => number(value * criterion.scale, criterion.digits),
        })
        .collect()
}

fn text_table(compared: &[Compared], place: &Place) -> String {
    let mut text = format!("{:<22} {:>14}", "estimator", "tuning");
    for criterion in &CRITERIA {
        let _ = write!(text, " {:>18}", criterion.name);
    }
    let _ = write!(text, "\n{:<22} {:>14}", "", "");
    for criterion in &CRITERIA {
        let _ = write!(text, " {:>18}", criterion.unit);
    }
    for c in compared {
        let _ = write!(text, "\n{:<22} {:>14}", c.entry.name(), tuning(c));
        for cell in cells(c, place) {
            let _ = write!(text, " {cell:>18}");
        }
    }
    text.push('\n');
    text
}

fn sentence(winner: &Winner) -> String {
    let name = CRITERIA.iter().find(|c| c.key == winner.criterion).map_or("", |c| c.name);
    let rank = match winner.butterworth_rank {
        Some(rank) => format!("; butterworth is number {rank}"),
        None => String::new(),
    };
    format!("{name}: best is {}{rank}", winner.estimators.join(", "))
}

fn page(
    scene: &NamedScene,
    compared: &[Compared],
    place: &Place,
    winners: &[Winner],
    figure: Figure,
    manifest: &Manifest,
) -> String {
    let mut columns = vec![("Estimator", ""), ("Tuning", "")];
    columns.extend(CRITERIA.iter().map(|criterion| (criterion.name, criterion.unit)));
    let best = compared.iter().map(|c| c.tuned.area()).fold(0.0, f64::max);
    let rows = compared.iter().map(|c| {
        let class = if c.tuned.area() == best { " class=\"ideal\"" } else { "" };
        let mut row = vec![c.entry.name(), tuning(c)];
        row.extend(cells(c, place));
        (class, row)
    });
    let mut notes = vec![
        table::roughness_note(place),
        format!(
            "Left if tuned wrong: the area at {MISTUNED_BY} times less and more, as a share of the best."
        ),
    ];
    notes.extend(compared.iter().filter(|c| c.tuned.at_edge).map(|c| {
        format!("{}: the best tuning is the end of the range that was searched.", c.entry.name())
    }));
    let largest = compared.iter().max_by(|a, b| a.tuned.area().total_cmp(&b.tuned.area()));
    let answer = match largest {
        Some(c) => format!("Largest Z-width area: {} ({})", c.entry.name(), tuning(c)),
        None => "Nothing was compared".into(),
    };
    report::page(
        &format!("{}: velocity estimators", scene.name),
        &answer,
        &[ReportFigure {
            figure,
            caption:
                "Boundary of the stable walls, one curve per estimator at the tuning with the \
                      largest area."
                    .into(),
        }],
        &[
            ("Winners", report::notes(&winners.iter().map(sentence).collect::<Vec<_>>())),
            ("Table", report::table(&columns, rows)),
            ("Notes", report::notes(&notes)),
            ("Scene", report::scene(&scene.text)),
            ("Provenance", report::provenance(&manifest.facts())),
        ],
    )
}
