//! The comparison as a table. CSV, JSON, the page and the list of winners use the same list of criteria.

use zwidth::{VelocitySettings, velocity};

use super::{
    Compared, Place, Wall,
    fidelity::{self, Point},
    roughness,
    search::{GAIN, LAST_STEP, OF_TWO, WALKS_OF_A_TRY},
    tuned::Edge,
};
use crate::{
    numerics::statistics::Repeats,
    scene::Units,
    study::boundary::Boundaries,
    table::{Cell, Kind, Table},
};

/// Which values of a criterion are the better ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    More,
    Less,
    /// The value that is nearer to 0, whether it is positive or negative.
    NearerToZero,
}

/// The printed table in which a criterion stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Criteria of the Z-width.
    Boundary,
    /// Criteria of the estimator alone, without the loop.
    Signal,
    /// Criteria that are measured in contact with walls.
    Contact,
    /// Criteria that show the effect of wrong settings, and the cost.
    Robustness,
}

impl Part {
    pub const ALL: [Self; 4] = [Self::Boundary, Self::Signal, Self::Contact, Self::Robustness];

    pub fn title(self) -> &'static str {
        match self {
            Self::Boundary => "Z-width (means of the repeats)",
            Self::Signal => "The estimator alone (h: moved by the hand, m: by the motor)",
            Self::Contact => "In contact",
            Self::Robustness => "Area that is left with wrong settings, and cost on the Cortex-M4",
        }
    }
}

pub struct Criterion {
    /// Name of the CSV column. It ends in the unit.
    pub key: &'static str,
    /// Name in printed tables.
    pub name: &'static str,
    /// Unit in printed tables.
    pub unit: &'static str,
    /// Factor from the CSV's unit to the printed unit.
    pub scale: f64,
    /// Number of digits after the point in printed tables.
    pub digits: usize,
    pub part: Part,
    /// Which values are better; `None` if the criterion does not rank estimators.
    pub better: Option<Better>,
    /// Gives the values of all repeats. It gives one value if the criterion is measured once, and none if the criterion
    /// does not apply.
    pub values: fn(&Compared, &Place) -> Vec<f64>,
}

impl Criterion {
    /// The mean of the values; `None` if the criterion does not apply.
    pub fn value(&self, c: &Compared, place: &Place) -> Option<f64> {
        let values = (self.values)(c, place);
        (!values.is_empty()).then(|| Repeats::of(values.iter().copied()).mean)
    }

    /// The value as text for printed tables.
    pub fn cell(&self, c: &Compared, place: &Place, units: Units) -> String {
        let (_, factor) = units.written(self.unit);
        let digits = |value: f64| match (factor == 1.0, value.abs()) {
            (true, _) => self.digits,
            (false, 100.0..) => 1,
            (false, 1.0..) => 3,
            (false, _) => 5,
        };
        self.value(c, place).map_or_else(
            || "-".into(),
            |v| {
                let told = v * self.scale * factor;
                crate::notation::number(told, digits(told))
            },
        )
    }

    /// The unit in printed tables. It depends on whether the scene is linear or rotary.
    pub fn unit(&self, units: Units) -> &'static str {
        units.written(self.unit).0
    }
}

/// Makes the list of criteria. An entry has three groups. The first group says in which table the criterion stands,
/// which values are better, and its CSV key. The second group has the name, the unit, the factor and the digits for
/// printed tables. The third group is the function that gives the values.
macro_rules! criteria {
    ($($part:ident $better:expr, $key:literal:
       $name:literal, $unit:expr, $scale:literal, $digits:literal, $values:expr;)*) => {
        [$(Criterion {
            key: $key,
            name: $name,
            unit: $unit,
            scale: $scale,
            digits: $digits,
            part: Part::$part,
            better: $better,
            values: $values,
        }),*]
    };
}

const AREA: &str = "10^6 N² s/m²";
const MORE: Option<Better> = Some(Better::More);
const LESS: Option<Better> = Some(Better::Less);
const NEARER: Option<Better> = Some(Better::NearerToZero);

pub const CRITERIA: [Criterion; 27] = criteria! {
    Boundary MORE, "area_n2_s_per_m2":
        "area", AREA, 1e-6, 2, |c, _| c.tuned.boundaries.areas();
    Boundary None, "area_low_n2_s_per_m2":
        "lowest", AREA, 1e-6, 2, |c, _| vec![c.tuned.boundaries.area_range()[0]];
    Boundary None, "area_high_n2_s_per_m2":
        "highest", AREA, 1e-6, 2, |c, _| vec![c.tuned.boundaries.area_range()[1]];
    Boundary None, "scene_area_n2_s_per_m2":
        "by the scene", AREA, 1e-6, 2, |c, _| c.beside.as_ref().map_or_else(Vec::new, Boundaries::areas);
    Boundary None, "share_of_true_velocity":
        "of true v", "%", 1e2, 0, |c, place| Vec::from_iter(share(c, place));
    Boundary MORE, "stiffness_peak_mean_n_per_m":
        "peak K", "kN/m", 1e-3, 1, |c, _| c.tuned.boundaries.stiffness_peaks_n_per_m();
    Boundary MORE, "stiffness_at_damping_mean_n_per_m":
        "K at B", "kN/m", 1e-3, 1,
        |c, place| c.tuned.boundaries.stiffnesses_at(place.middle().damping_n_s_per_m);
    Boundary MORE, "damping_max_mean_n_s_per_m":
        "largest B", "N s/m", 1.0, 0, |c, _| c.tuned.boundaries.dampings_max_n_s_per_m();
    Signal None, "bandwidth_hz":
        "-3 dB", "Hz", 1.0, 0, |c, _| vec![c.tuned.bandwidth_hz];
    Signal NEARER, "delay_hand_s":
        "delay h", "ms", 1e3, 3, |c, _| vec![c.signal.delay_s.hand];
    Signal NEARER, "delay_motor_s":
        "delay m", "ms", 1e3, 3, |c, _| vec![c.signal.delay_s.motor];
    Signal None, "phase_100_hz_hand_deg":
        "100 Hz h", "deg", 1.0, 1, |c, _| vec![c.signal.phase_100_hz_deg.hand];
    Signal None, "phase_100_hz_motor_deg":
        "100 Hz m", "deg", 1.0, 1, |c, _| vec![c.signal.phase_100_hz_deg.motor];
    Signal LESS, "noise_at_rest_m_per_s":
        "noise, rest", "mm/s", 1e3, 3, |c, _| vec![c.signal.noise_at_rest_m_per_s];
    Signal LESS, "noise_in_motion_m_per_s":
        "noise, motion", "mm/s", 1e3, 3, |c, _| vec![c.signal.noise_in_motion_m_per_s];
    Contact LESS, "roughness_n":
        "force > 100 Hz", "mN", 1e3, 1, |c, _| roughness(c);
    Contact None, "roughness_low_n":
        "lowest", "mN", 1e3, 1, |c, _| Vec::from_iter(roughness(c).into_iter().reduce(f64::min));
    Contact None, "roughness_high_n":
        "highest", "mN", 1e3, 1, |c, _| Vec::from_iter(roughness(c).into_iter().reduce(f64::max));
    Contact LESS, "impedance_error":
        "impedance error", "%", 1e2, 2, |c, _| at_all_walls(c, c.fidelity.error);
    Contact LESS, "impedance_error_of_estimator":
        "estimator's share", "%", 1e2, 2, |c, _| at_all_walls(c, c.fidelity.of_estimator);
    Robustness None, "left_when_bandwidth_low":
        "-3 dB /1.2", "%", 1e2, 0, |c, _| Vec::from_iter(c.tuned.left_when_mistuned[0]);
    Robustness None, "left_when_bandwidth_high":
        "-3 dB x1.2", "%", 1e2, 0, |c, _| Vec::from_iter(c.tuned.left_when_mistuned[1]);
    Robustness MORE, "left_when_bandwidth_wrong":
        "worse of both", "%", 1e2, 0, |c, _| Vec::from_iter(worse(c.tuned.left_when_mistuned));
    Robustness None, "left_when_mass_low":
        "mass -20 %", "%", 1e2, 0, |c, _| Vec::from_iter(c.tuned.left_when_mass_is_wrong[0]);
    Robustness None, "left_when_mass_high":
        "mass +20 %", "%", 1e2, 0, |c, _| Vec::from_iter(c.tuned.left_when_mass_is_wrong[1]);
    Robustness LESS, "cycles":
        "cycles", "", 1.0, 0, |c, _| Vec::from_iter(c.cost.map(|cost| cost.cycles));
    Robustness LESS, "ram_bytes":
        "RAM", "bytes", 1.0, 0, |c, _| Vec::from_iter(c.cost.map(|cost| cost.ram_bytes));
};

/// The mean area as a share of the area that the true velocity reaches.
fn share(c: &Compared, place: &Place) -> Option<f64> {
    (place.told_area > 0.0).then(|| c.tuned.boundaries.area() / place.told_area)
}

/// Roughness of each hit at the middle wall. The list is empty if that wall is unstable.
fn roughness(c: &Compared) -> Vec<f64> {
    let [_, middle, _] = &c.contacts;
    if middle.stable { middle.roughness_n.clone() } else { vec![] }
}

/// A list with the value if all walls are stable, and an empty list otherwise.
fn at_all_walls(c: &Compared, value: f64) -> Vec<f64> {
    if c.contacts.iter().all(|contact| contact.stable) { vec![value] } else { vec![] }
}

/// The smaller of two values, if both exist.
fn worse([low, high]: [Option<f64>; 2]) -> Option<f64> {
    low.zip(high).map(|(low, high)| low.min(high))
}

pub fn search_walks(c: &Compared) -> u32 {
    c.tuned.tried.iter().map(|tried| tried.walks).sum()
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    pub name: &'static str,
    pub unit: &'static str,
    /// The value that the search found.
    pub value: f64,
    /// The end of the search range that the value has reached; `None` if the value is inside the range.
    pub edge: Option<Edge>,
}

/// The tuning and the second parameter. Each is `None` if the estimator does not have it.
pub fn parameters(c: &Compared) -> [Option<Parameter>; 2] {
    [0, 1].map(|n| {
        let (velocity::Parameter { name, unit, .. }, value) = c.settings.parameter(n)?;
        Some(Parameter { name, unit, value, edge: c.tuned.edges[n] })
    })
}

pub(super) fn value_and_unit(settings: &VelocitySettings, n: usize) -> [Cell; 2] {
    let parameter = settings.parameter(n);
    parameter.map_or([Cell::Empty, Cell::Empty], |(of, value)| [value.into(), of.unit.into()])
}

fn area_text(area: f64, units: Units) -> String {
    match units.written("N² s/m²") {
        (unit, factor) if factor != 1.0 => format!("{:.4e} {unit}", area * factor),
        _ => format!("{:.2} 10^6 N^2 s/m^2", area * 1e-6),
    }
}

/// One row for each estimator.
pub fn table(compared: &[Compared], place: &Place) -> Table {
    let own = [
        ("estimator", Kind::Text),
        ("needs", Kind::Text),
        ("tuning", Kind::Number),
        ("tuning_unit", Kind::Text),
        ("tuning_at_edge", Kind::Flag),
        ("second", Kind::Number),
        ("second_unit", Kind::Text),
        ("second_at_edge", Kind::Flag),
        ("search_walks", Kind::Whole),
        ("search_settled", Kind::Flag),
        ("hits", Kind::Whole),
        ("stable_at_walls", Kind::Whole),
    ];
    let criteria = CRITERIA.iter().map(|criterion| (criterion.key, Kind::Number));
    let mut table = Table::new(own.into_iter().chain(criteria));
    for c in compared {
        let mut row: Vec<Cell> = vec![c.entry.name().into(), c.needs().into()];
        for (n, edge) in c.tuned.edges.iter().enumerate() {
            row.extend(value_and_unit(&c.settings, n));
            row.push((edge.is_some() && c.settings.parameter(n).is_some()).into());
        }
        row.push(Cell::Whole(search_walks(c).into()));
        row.push(c.tuned.settled.into());
        row.push(Cell::Whole(c.tuned.hits));
        row.push(Cell::count(stable_at_walls(c)));
        let values = CRITERIA.iter().map(|criterion| criterion.value(c, place));
        row.extend(values.map(Cell::number));
        table.rows.push(row);
    }
    table
}

/// The number of walls of the comparison at which the loop is stable.
pub fn stable_at_walls(c: &Compared) -> usize {
    c.contacts.iter().filter(|contact| contact.stable).count()
}

/// A table of every tried tuning, in the order in which they were tried.
pub fn tunings(compared: &[Compared]) -> Table {
    let mut table = Table::new([
        ("estimator", Kind::Text),
        ("tuning", Kind::Number),
        ("tuning_unit", Kind::Text),
        ("second", Kind::Number),
        ("second_unit", Kind::Text),
        ("area_n2_s_per_m2", Kind::Number),
    ]);
    for c in compared {
        for tried in &c.tuned.tried {
            let mut row: Vec<Cell> = vec![c.entry.name().into()];
            row.extend([0, 1].into_iter().flat_map(|n| value_and_unit(&tried.settings, n)));
            row.push(tried.area.into());
            table.rows.push(row);
        }
    }
    table
}

/// A table of the boundaries at the results of the searches. It has every point of every walk.
pub fn boundaries(compared: &[Compared]) -> Table {
    Boundaries::table(
        "estimator",
        compared.iter().map(|c| (c.entry.name().into(), &c.tuned.boundaries)),
    )
}

/// A table of the errors of the rendered impedance, by wall and frequency.
pub fn fidelities(compared: &[Compared]) -> Table {
    let numbers = [
        "stiffness_n_per_m",
        "damping_n_s_per_m",
        "frequency_hz",
        "impedance_error",
        "impedance_error_of_estimator",
        "impedance_error_of_loop",
    ];
    let numbers = numbers.map(|name| (name, Kind::Number));
    let mut table = Table::new([("estimator", Kind::Text)].into_iter().chain(numbers));
    for c in compared {
        for &Point { wall, frequency_hz, error, of_estimator, of_loop } in &c.fidelity.points {
            let Wall { stiffness_n_per_m, damping_n_s_per_m } = wall;
            let mut row: Vec<Cell> = vec![c.entry.name().into()];
            row.extend(
                [stiffness_n_per_m, damping_n_s_per_m, frequency_hz, error, of_estimator, of_loop]
                    .map(Cell::Number),
            );
            table.rows.push(row);
        }
    }
    table
}

/// Notes that explain the tables to a reader. Each note is one sentence.
pub fn notes(compared: &[Compared], place: &Place, units: Units) -> Vec<String> {
    let (k, b) = (place.middle().stiffness_n_per_m, place.middle().damping_n_s_per_m);
    let walls = place.walls.map(|wall| {
        format!("K = {:.0} N/m, B = {} N s/m", wall.stiffness_n_per_m, wall.damping_n_s_per_m)
    });
    let mut notes = vec![
        format!(
            "The searches walk from {WALKS_OF_A_TRY} starts that are no repeat's, a tuning that cannot win from the \
             first only, and settle where no neighbour is better by more than {} % at steps of {:.0} % of bandwidth or less; with two \
             parameters they may try {OF_TWO} times as many tunings as with one.",
            100.0 * GAIN,
            100.0 * (LAST_STEP * LAST_STEP - 1.0)
        ),
        format!(
            "K at B is at B = {b} N s/m. Force above {} Hz is its RMS in {} wall hits at K = {k:.0} N/m, \
             B = {b} N s/m; it is empty where that wall is not stable.",
            roughness::ROUGH_ABOVE_HZ,
            roughness::HITS
        ),
        format!(
            "Impedance from 1 to 100 Hz under a prescribed motion at {}: geometric mean over walls and \
             frequencies; empty where one of the walls is not stable. Left out: {}.",
            walls.join("; "),
            fidelity::LEFT_OUT
        ),
    ];
    if let Some(first) = compared.first() {
        notes.push(format!(
            "Hold and latency of the loop alone, with the true velocity, make an impedance error of \
             {:.2} %; the estimator's share is the distance from that.",
            100.0 * first.fidelity.of_loop
        ));
    }
    notes.push(format!(
        "The true velocity (no noise, quantisation or delay; the counts stay) reaches an area of {} here: `of true v` is \
         the share of it.",
        area_text(place.told_area, units)
    ));
    let hits: u64 = compared.iter().map(|c| c.tuned.hits).sum();
    notes.push(format!(
        "{hits} wall hits were asked for: by the searches, at their results, and at the wrong tunings."
    ));
    let unsettled = compared.iter().filter(|c| !c.tuned.settled).map(|c| c.entry.name());
    let unsettled: Vec<String> = unsettled.collect();
    if !unsettled.is_empty() {
        notes.push(format!(
            "Not settled, their tunings used up: {}; a larger --budget may find more.",
            unsettled.join(", ")
        ));
    }
    notes.push(
        "An estimator that knows a force knows the motor's only: when it is granted, as on our boards, or, with \
         the latency known (`told in time`), when it acts. The push \
         of a wall hit is the motor's too, so there it knows all of the force; of a hand's it would know nothing. \
         Delay and phase are given for a motion made by the hand and for one made by the motor; noise with no force."
            .into(),
    );
    for c in compared {
        for parameter in parameters(c).into_iter().flatten() {
            let why = match parameter.edge {
                None => continue,
                Some(Edge::Core) => "the core accepts nothing beyond",
                Some(Edge::Search) => "nothing beyond was searched",
            };
            let name = c.entry.name();
            notes.push(format!(
                "{name}: the best {} is an end of its range; {why}.",
                parameter.name
            ));
        }
    }
    notes.into_iter().map(|note| units.text(&note)).collect()
}
