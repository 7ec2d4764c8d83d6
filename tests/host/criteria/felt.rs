//! Finds the coarsest encoder with which the median person does not feel a wall hum.

use host_sim::study::loops::boards;

use super::*;
use crate::figure::figure;

const STIFFNESS_N_PER_M: f64 = 20_000.0;
const CUTOFFS_HZ: [f64; 9] = [70.0, 100.0, 150.0, 200.0, 300.0, 500.0, 700.0, 1000.0, 2000.0];
/// Number of tried resolutions per octave.
const PER_OCTAVE: f64 = 4.0;
/// The coarsest tried resolution, in m.
const COARSEST_M: f64 = 16e-6;

/// Searches for a wall with the test's stiffness that stays below the limit from four starts. Returns the wall's cutoff
/// and B, or `None` if there is no such wall.
fn unfelt(scene: &Scene) -> Option<[f64; 2]> {
    let prepared = PreparedScene::new(scene).unwrap();
    let dampings = || (1..=30).map(|n| 10.0 * f64::from(n));
    let walls = CUTOFFS_HZ.into_iter().flat_map(|hz| dampings().map(move |b| [hz, b]));
    let is_stable = |[cutoff_hz, damping_n_s_per_m]: &[f64; 2]| {
        [0.0, 0.25, 0.5, 0.75].into_iter().all(|start_offset_counts| {
            let hit = WallHit {
                velocity: scene.velocity.at(*cutoff_hz),
                stiffness_n_per_m: STIFFNESS_N_PER_M,
                damping_n_s_per_m: *damping_n_s_per_m,
                start_offset_counts,
            };
            prepared.verdict(Numeric::Fixed, &hit).unwrap() == Verdict::Stable
        })
    };
    walls.into_iter().find(is_stable)
}

/// Finds the coarsest encoder with which a person does not feel a wall of 20,000 N/m hum. The tried resolutions go from
/// 16 um down, in steps of a quarter of an octave. An encoder passes if the wall stays below the limit from four
/// starts, at one cutoff and one B of 10 to 300 N s/m. The limits of the sensation level are -12, 0 and 12 dB. The
/// motor pushes. The loops are the paper's and the NUCLEO's.
///
/// `cargo test --release --test host criteria::felt -- --ignored --nocapture` prints the encoders.
#[test]
#[ignore = "a table of docs/lab/criteria-measured.md"]
fn how_fine_an_encoder_nobody_feels() {
    let paper = paper("paper-1um");
    let [(_, board), _] = boards(&paper).unwrap().try_into().unwrap();
    for (name, own) in [("paper", paper), ("board", board)] {
        let mut coarser = f64::INFINITY;
        for level_db in [12.0, 0.0, -12.0] {
            let mut scene = own.clone();
            scene.wall_hit.criterion = Criterion::Felt;
            scene.wall_hit.felt_limit_db = level_db;
            let resolutions = (0..).map(|n| COARSEST_M * (-f64::from(n) / PER_OCTAVE).exp2());
            let found = resolutions.take_while(|m| *m > 2e-8).find_map(|resolution_m| {
                scene.encoder.resolution_m = resolution_m;
                scene.check().ok()?;
                unfelt(&scene).map(|wall| (resolution_m, wall))
            });
            let Some((resolution_m, [cutoff_hz, damping])) = found else {
                panic!("{name} {level_db} dB: no encoder is fine enough")
            };
            println!("{name} {level_db} dB: {resolution_m:.3e} m, {cutoff_hz} Hz, B = {damping}");
            for (key, value) in
                [("um", 1e6 * resolution_m), ("cutoff_hz", cutoff_hz), ("damping", damping)]
            {
                figure(&format!("host/criteria/felt/{name}/{level_db}/{key}"), value);
            }
            assert!(resolution_m <= coarser, "who feels more needs a finer one");
            coarser = resolution_m;
        }
    }
}
