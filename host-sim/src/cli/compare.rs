//! `compare`: compares all velocity estimators.

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    conditions::Conditions,
    peers::{self, PeerArgs},
    progress,
    shared::{Typed, listed},
    usable::{self, UsableArgs},
};
use crate::{
    analysis::compare::{
        Class, Compared, Entry, Place, Wall, compare, most_walks,
        search::{Budget, MASS_WRONG_BY, WRONG_BY},
        table::{self, CRITERIA, Part},
        terminal,
        winners::{self, Winner},
    },
    error::Error,
    interrupt,
    output::{
        figure::{self, Curve, Figure, ZwidthPlot},
        in_units::InUnits,
        manifest::Manifest,
        report::{self, ReportFigure},
        terminal::print_result,
    },
    scene::{NamedScene, Units},
    study::{
        asked::{check_read_off, prepare},
        recommended::Ranked,
    },
};

/// Compares velocity estimators by Z-width, delay, noise, roughness, fidelity and cost. The same search tunes each
/// estimator.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Built-in scene or scene file. The scene's estimator is not used.
    scene: String,
    /// Estimators by their names in the table, A,B,C [default: all except second-order, smoothing, tracking-lead,
    /// window-difference, biquad and biquad-2].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    estimators: Vec<String>,
    /// B at which K and contacts are compared, in N s/m. The impedance is also compared at half and at twice this B
    /// [default: 100, at most half of the largest B of finite difference and Butterworth].
    #[arg(long, value_name = "N_S_PER_M", allow_negative_numbers = true)]
    damping: Option<f64>,
    /// Number of tunings that the search may try for an estimator with one parameter, with two walks each. With two
    /// parameters, four times as many are allowed. The search ends earlier if no tuning nearby is better.
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(3..=1000))]
    budget: u32,
    /// Walks for the result of each search, with starts spread over one count.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
    #[command(flatten)]
    conditions: Conditions,
    #[command(flatten)]
    peers: PeerArgs,
    #[command(flatten)]
    usable: UsableArgs,
}

const FILES: &[&str] = &[
    "compare.csv",
    "tuning.csv",
    "boundary.csv",
    "fidelity.csv",
    "zwidth",
    "zwidth_more",
    "report.html",
];

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    /// Damping and stiffness of the wall at which the forces are compared.
    damping_n_s_per_m: f64,
    stiffness_n_per_m: f64,
    /// Walls at which the impedance is compared.
    walls: [Wall; 3],
    /// Mean area with the true velocity.
    true_velocity_area_n2_s_per_m2: f64,
    /// Error of the impedance if the loop gets the true velocity. Only output hold and latency cause this error.
    impedance_error_of_loop: Option<f64>,
    estimators: Vec<JsonRow>,
    winners: &'a [Winner],
    notes: Vec<String>,
}

#[derive(Serialize)]
struct JsonRow {
    estimator: String,
    needs: &'static str,
    class: &'static str,
    tuning: Option<f64>,
    tuning_unit: Option<&'static str>,
    tuning_at_edge: bool,
    second: Option<f64>,
    second_name: Option<&'static str>,
    second_unit: Option<&'static str>,
    second_at_edge: bool,
    search_walks: u32,
    search_settled: bool,
    hits: u64,
    stable_at_walls: usize,
    #[serde(flatten)]
    criteria: serde_json::Map<String, serde_json::Value>,
}

pub fn run(args: &CompareArgs, common: &Common) -> Result<(), Error> {
    let mut scene = NamedScene::load(&args.scene)?;
    args.conditions.apply(&mut scene.scene).map_err(|error| error.of(&scene.name))?;
    common.only_fixed("compare")?;
    if args.peers.peers {
        return peers::run(&args.peers, args.repeat, &scene, common);
    }
    let budget = Budget { tunings: args.budget, repeats: args.repeat };
    prepare(&scene)?;
    if let Some(percents) = &args.usable.usable {
        let named = (!args.estimators.is_empty())
            .then(|| Entry::named(&args.estimators, &scene, "--estimators"));
        let named = named.transpose()?;
        return usable::run(percents, named, &args.conditions, budget, &scene, common);
    }
    let entries = Entry::named(&args.estimators, &scene, "--estimators")?;
    let units = scene.scene.units;
    let damping = args.damping.map(|damping| units.damping_n_s_per_m(damping));
    if let Some(damping) = damping {
        check_read_off(&scene, damping, "--damping")?;
    }
    let mut to = common.fill(&scene, "compare", FILES)?;
    let Ranked { scene, beside } = args.conditions.ranked(&scene, common)?;
    let bar = progress::bar(most_walks(&entries, budget));
    let (place, compared) = compare(
        common.engine,
        (&scene.scene, beside.as_ref()),
        &entries,
        damping,
        budget,
        interrupt::flag(),
        |walks| bar.inc(walks),
    )?;
    bar.finish_and_clear();
    let winners = winners::winners(&compared, &place);
    let manifest = Manifest::new(command_line(args, common, &scene, &place), &scene);
    let mut figures = vec![];
    for (class, stem) in Class::ALL.into_iter().zip(["zwidth", "zwidth_more"]) {
        if compared.iter().any(|c| c.class() == class) {
            let figure = zwidth(&scene, &compared, class)?;
            to.figure(stem, &figure)?;
            let caption = format!(
                "Boundary of the stable walls, estimators {}, each at the tuning with the largest area.",
                class.text()
            );
            figures.push(ReportFigure { figure, caption });
        }
    }
    to.add("compare.csv", table::table(&compared, &place).csv())?;
    to.add("tuning.csv", table::tunings(&compared).csv())?;
    to.add("boundary.csv", table::boundaries(&compared).csv())?;
    to.add("fidelity.csv", table::fidelities(&compared).csv())?;
    to.add("report.html", page(&scene, &compared, &place, &winners, &figures, &manifest))?;
    let results = to.finish(&manifest)?;
    let mut notes = table::notes(&compared, &place, units);
    notes.extend(scene.scene.estimated_note());
    let json = Json {
        scene: &scene.name,
        damping_n_s_per_m: place.middle().damping_n_s_per_m,
        stiffness_n_per_m: place.middle().stiffness_n_per_m,
        walls: place.walls,
        true_velocity_area_n2_s_per_m2: place.told_area,
        impedance_error_of_loop: compared.first().map(|c| c.fidelity.of_loop),
        estimators: compared.iter().map(|c| json_row(c, &place)).collect(),
        winners: &winners.iter().map(|winner| winner.told(units)).collect::<Vec<_>>(),
        notes,
    };
    print_result(common.json, InUnits(units, json), || {
        let text = terminal::text(&compared, &place, &winners, units);
        let estimated = scene.scene.estimated_note().map_or_else(String::new, |note| note + "\n");
        format!("{text}{estimated}\n{results}")
    })
}

fn command_line(args: &CompareArgs, common: &Common, scene: &NamedScene, place: &Place) -> String {
    let (_, factor) = scene.scene.units.written("N s/m");
    Typed::new("compare", &scene.name)
        .maybe("estimators", listed(&args.estimators))
        .and(&args.conditions.as_typed())
        .with("damping", Units::told(place.middle().damping_n_s_per_m, factor))
        .with("budget", args.budget)
        .with("repeat", args.repeat)
        .by(common)
}

fn tuning(c: &Compared) -> String {
    let parameters = table::parameters(c).into_iter().flatten();
    let texts: Vec<String> = parameters
        .enumerate()
        .map(|(n, parameter)| {
            let value = terminal::parameter(Some(parameter));
            if n == 0 { value } else { format!("{} {value}", parameter.name) }
        })
        .collect();
    texts.join(", ")
}

/// The estimator of this class that has the largest mean area.
fn best_of(compared: &[Compared], class: Class) -> Option<Entry> {
    let like = compared.iter().filter(|c| c.class() == class);
    like.max_by(|a, b| a.tuned.boundaries.area().total_cmp(&b.tuned.boundaries.area()))
        .map(|c| c.entry)
}

fn zwidth(scene: &NamedScene, compared: &[Compared], class: Class) -> Result<Figure, Error> {
    let best = best_of(compared, class);
    let curves = compared.iter().filter(|c| c.class() == class).map(|c| Curve {
        name: c.entry.name(),
        detail: format!("{}, {}", c.entry.name(), tuning(c)),
        ideal: best == Some(c.entry),
        points: c.tuned.boundaries.first().map(|first| first.points.clone()).unwrap_or_default(),
    });
    Ok(figure::zwidth(&ZwidthPlot {
        title: format!("Z-width by estimator, {}, {}", class.text(), scene.name),
        units: scene.scene.units,
        subtitle: "each at the tuning with the largest area; ideal: the largest of them".into(),
        marked: "ideal",
        legend: "Estimator".into(),
        curves: curves.collect(),
    })?)
}

fn json_row(c: &Compared, place: &Place) -> JsonRow {
    let criteria = CRITERIA
        .iter()
        .map(|criterion| (criterion.key.to_owned(), serde_json::json!(criterion.value(c, place))));
    let [tuning, second] = table::parameters(c);
    JsonRow {
        estimator: c.entry.name(),
        needs: c.needs(),
        class: c.class().name(),
        tuning: tuning.map(|p| p.value),
        tuning_unit: tuning.map(|p| p.unit),
        tuning_at_edge: tuning.is_some_and(|p| p.edge.is_some()),
        second: second.map(|p| p.value),
        second_name: second.map(|p| p.name),
        second_unit: second.map(|p| p.unit),
        second_at_edge: second.is_some_and(|p| p.edge.is_some()),
        search_walks: table::search_walks(c),
        search_settled: c.tuned.settled,
        hits: c.tuned.hits,
        stable_at_walls: table::stable_at_walls(c),
        criteria: criteria.collect(),
    }
}

fn page(
    scene: &NamedScene,
    compared: &[Compared],
    place: &Place,
    winners: &[Winner],
    figures: &[ReportFigure],
    manifest: &Manifest,
) -> String {
    let units = scene.scene.units;
    let best = best_of(compared, Class::PositionOnly);
    let class = |c: &Compared| if best == Some(c.entry) { " class=\"ideal\"" } else { "" };
    let tunings = report::table(
        &[("Estimator", ""), ("Needs", ""), ("Tuning (*: an end of the range)", "")],
        compared.iter().map(|c| (class(c), vec![c.entry.name(), c.needs().into(), tuning(c)])),
    );
    let part = |part: Part| {
        let criteria: Vec<_> = CRITERIA.iter().filter(|criterion| criterion.part == part).collect();
        let mut columns = vec![("Estimator", "")];
        columns.extend(criteria.iter().map(|criterion| (criterion.name, criterion.unit(units))));
        let rows = compared.iter().map(|c| {
            let mut row = vec![c.entry.name()];
            row.extend(criteria.iter().map(|criterion| criterion.cell(c, place, units)));
            (class(c), row)
        });
        (part.title(), report::table(&columns, rows))
    };
    let mut notes = table::notes(compared, place, units);
    notes.extend(scene.scene.estimated_note());
    notes.push(format!(
        "Area that is left: at a -3 dB bandwidth {WRONG_BY} times lower and higher, and with a model's \
         mass {} % too small and too large, as a share of the best.",
        100.0 * MASS_WRONG_BY
    ));
    let mut sections = vec![
        ("Winners", report::notes(&winners.iter().map(winners::sentence).collect::<Vec<_>>())),
        ("Tunings", tunings),
    ];
    sections.extend(Part::ALL.map(part));
    sections.push(("Notes", report::notes(&notes)));
    sections.push(("Scene", report::scene(&scene.text)));
    sections.push(("Provenance", report::provenance(&manifest.facts())));
    let areas = winners.iter().filter(|winner| winner.criterion == "area_n2_s_per_m2");
    let answers: Vec<String> = areas.map(winners::sentence).collect();
    let answer = answers.join(". ");
    report::page(&format!("{}: velocity estimators", scene.name), &answer, figures, &sections)
}
