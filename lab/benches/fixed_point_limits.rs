//! The limits of fixed point for many encoder resolutions and cutoffs. The first result is the number of verdicts in
//! which the core differs from its exact `f64` twin. The second result is this number for a twin that rounds only the
//! velocity, to the core's LSB. Walls at the boundary are chaotic. So the second number is a lower limit for any
//! arithmetic with this velocity format.
//!
//! `cargo run --release -p host-sim-bench --bin fixed_point_limits` writes
//! `docs/figures/fixed-point-limits.{csv,png}`.

use std::{fmt::Write as _, fs, path::Path, process::ExitCode, sync::atomic::AtomicBool};

use host_sim::{
    engine::{Depth, Engine, stream},
    error::Error,
    output::figure::{Mark, TradePanel, TradePlot, TradeSeries, trade},
    scene::NamedScene,
    simulation::prepared::{Numeric, PreparedScene, WallHit},
};
use zwidth::{VelocitySettings, experiment::Verdict};

const RESOLUTIONS_M: [f64; 6] = [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3];
const CUTOFFS_HZ: [f64; 13] =
    [0.36, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 4900.0];
/// Number of values of K and of B that are tried. K goes from 100 to 1e6 N/m and B from 0.1 to 1000 N s/m, both in
/// equal ratios. `STARTS` is the number of start positions of a hit.
const STEPS: u64 = 12;
const STARTS: u64 = 2;

fn hit(cutoff_hz: f64, number: u64) -> WallHit {
    let part = |n: u64| n as f64 / (STEPS - 1) as f64;
    WallHit {
        velocity: VelocitySettings::Butterworth { cutoff_hz },
        stiffness_n_per_m: 100.0 * 1e4f64.powf(part(number % STEPS)),
        damping_n_s_per_m: 0.1 * 1e4f64.powf(part(number / STEPS % STEPS)),
        start_offset_counts: 0.5 * (number / STEPS / STEPS) as f64,
    }
}

/// The verdicts of all walls. The list is empty if the handle leaves the range of the core.
fn verdicts(
    prepared: &PreparedScene,
    numeric: Numeric,
    cutoff_hz: f64,
) -> Result<Vec<Option<Verdict>>, Error> {
    let mut all = vec![];
    let total = STEPS * STEPS * STARTS;
    let stop = AtomicBool::new(false);
    let each = |number| hit(cutoff_hz, number);
    stream(
        Engine::lanes(),
        prepared,
        numeric,
        Depth::Verdict,
        total,
        each,
        &stop,
        |_, outcome| {
            all.push(outcome.ok().map(|outcome| outcome.verdict));
            Ok(())
        },
    )?;
    Ok(all)
}

fn run() -> Result<(), Error> {
    let mut csv =
        String::from("resolution_m,cutoff_hz,walls,stable,differ_fixed,differ_rounded_velocity\n");
    let mut series = vec![];
    for (colour, resolution_m) in RESOLUTIONS_M.into_iter().enumerate() {
        let mut scene = NamedScene::load("paper-1um")?.scene;
        scene.encoder.resolution_m = resolution_m;
        // The RMS limit is 15 um, or 15 counts if a count is longer than 1 um.
        scene.wall_hit.rms_limit_m = 15.0 * resolution_m.max(1e-6);
        let prepared = PreparedScene::new(&scene)?;
        let mut points = vec![vec![], vec![]];
        for cutoff_hz in CUTOFFS_HZ {
            let exact = verdicts(&prepared, Numeric::F64, cutoff_hz)?;
            let stable = exact.iter().filter(|verdict| **verdict == Some(Verdict::Stable)).count();
            let mut differ = [0; 2];
            for (n, numeric) in [Numeric::Fixed, Numeric::F64Rounded].into_iter().enumerate() {
                let others = verdicts(&prepared, numeric, cutoff_hz)?;
                differ[n] = exact.iter().zip(&others).filter(|(a, b)| a != b).count();
                points[n].push([cutoff_hz, 100.0 * differ[n] as f64 / exact.len() as f64]);
            }
            let [fixed, rounded] = differ;
            let walls = exact.len();
            let _ = writeln!(csv, "{resolution_m},{cutoff_hz},{walls},{stable},{fixed},{rounded}");
        }
        let name = match resolution_m {
            r if r < 1e-6 => format!("{:.0} nm", r * 1e9),
            r if r < 1e-3 => format!("{:.0} um", r * 1e6),
            r => format!("{:.0} mm", r * 1e3),
        };
        let mark = [Mark::Circle, Mark::Square, Mark::Triangle, Mark::Diamond][colour % 4];
        series.push(TradeSeries { name, colour, mark, points });
    }
    print!("{csv}");
    let panel = |title: &str| TradePanel {
        title: title.to_owned(),
        y_title: "differ, %".to_owned(),
        limit: None,
        floor: 0.1,
        front: vec![],
    };
    let figure = trade(&TradePlot {
        title: "Verdicts that differ from those of exact arithmetic".to_owned(),
        subtitle: format!(
            "paper's device, 10 kHz, {} walls each; at the lower edge: none",
            STEPS * STEPS * STARTS
        ),
        legend: "resolution".to_owned(),
        x_title: "nominal cutoff, Hz".to_owned(),
        panels: vec![panel("fixed-point core"), panel("f64, velocity rounded")],
        series,
        lines: true,
    })?;
    let png = figure.png()?;
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/figures");
    for (name, bytes) in
        [("fixed-point-limits.csv", csv.as_bytes()), ("fixed-point-limits.png", &png[..])]
    {
        let path = folder.join(name);
        fs::write(&path, bytes).map_err(Error::file(path))?;
    }
    Ok(())
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
