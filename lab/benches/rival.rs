//! Measures the processor time of `cargo sim sweep --repeat 1 --plain` for both paper scenes, with figures and
//! envelope. The benchmark compares this time with the time of a C program (`rival/rival.c`), which walks the same
//! boundaries hit by hit. Before the measurement, the benchmark checks that both programs find the same boundaries in
//! `f64`.
//!
//! The benchmark also measures the sweep without `--plain`. This sweep also has walks with a limit of 1 um, by motor
//! and by hand. The rounds of all programs are interleaved. Only the best round of a program counts. The benchmark
//! needs a C compiler named `cc`. The result is docs/data/batch-rival.csv.
#![allow(clippy::unwrap_used, reason = "a benchmark fails loudly")]

use std::{
    fmt::Write as _,
    fs,
    io::Write as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::atomic::AtomicBool,
};

use host_sim::{
    engine::Engine,
    numerics::exact::oscillator_step,
    scene::NamedScene,
    simulation::prepared::{Numeric, PreparedScene, WallHit},
    study::walk::walk,
};
use zwidth::{units::Force, velocity::ButterworthDesign};

const SCENES: [&str; 2] = ["paper-1um", "paper-2um"];
const ROUNDS: usize = 5;

/// Describes one walk of a scene at one cutoff, as an input line of the C program.
fn line(prepared: &PreparedScene, cutoff_hz: f64) -> String {
    let (scene, design, plan) = (prepared.scene(), prepared.design(), prepared.plan());
    let device = &scene.device;
    let [k, b] = [device.stiffness_n_per_m, device.damping_n_s_per_m].map(|c| c / device.mass_kg);
    let ([[xx, xv], [vx, vv]], gamma) = oscillator_step(k, b, 1.0 / design.rate_hz);
    let mobility = 1.0 / device.mass_kg;
    let wall = WallHit {
        velocity: scene.velocity.at(cutoff_hz),
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        start_offset_counts: 0.0,
    };
    let surface = prepared.core(&wall).unwrap().control().wall.surface().counts();
    let per_count = design.resolution_m / design.full_scale_n;
    let push = f64::from(plan.push.bits()) / f64::from(Force::FULL_SCALE.bits());
    let ButterworthDesign { b0, a1, a2, .. } =
        ButterworthDesign::new(cutoff_hz, design.rate_hz, false).unwrap();
    let numbers = [
        design.resolution_m,
        xx,
        xv,
        vx,
        vv,
        gamma[0] * mobility,
        gamma[1] * mobility,
        device.rest_position_m,
        device.start_position_m,
        f64::from(surface),
        per_count,
        per_count * design.rate_hz,
        push,
        design.full_scale_n,
        scene.wall_hit.rms_limit_m / design.resolution_m,
        b0,
        a1,
        a2,
    ];
    numbers.map(|number| format!("{number:e}")).join(" ")
}

fn compiled(folder: &Path, options: &[&str]) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("rival/rival.c");
    let program = folder.join(format!("rival{}", options.len()));
    let mut compiler = Command::new("cc");
    compiler.args(["-O3", "-march=native"]).args(options).arg("-o").arg(&program).arg(source);
    assert!(compiler.arg("-lm").status().expect("a C compiler as `cc`").success());
    program
}

fn run(program: &Path, walks: &str) -> String {
    let mut child =
        Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(walks.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

/// Builds the simulator as `cargo sim` does, and returns its path.
fn simulator() -> PathBuf {
    let build = ["build", "--quiet", "--release", "--package", "host-sim"];
    assert!(Command::new(env!("CARGO")).args(build).status().unwrap().success());
    let here = std::env::current_exe().unwrap(); // target/release/deps/rival-..
    here.ancestors().nth(2).unwrap().join("host-sim")
}

/// Processor time that all ended child processes have used, in s.
fn children_s() -> f64 {
    const TICKS_PER_S: f64 = 100.0; // Linux uses this unit on every machine
    let text = fs::read_to_string("/proc/self/stat").unwrap();
    let fields = text.rsplit(") ").next().unwrap().split(' ');
    fields.skip(13).take(2).map(|ticks| ticks.parse::<f64>().unwrap()).sum::<f64>() / TICKS_PER_S
}

/// Runs `child` and returns the processor time of the processes that it started, in s.
fn timed(child: impl FnOnce()) -> f64 {
    let before_s = children_s();
    child();
    children_s() - before_s
}

fn main() {
    if std::env::args().any(|argument| argument == "--test") {
        return; // `cargo test --benches` only checks that the benchmark starts
    }
    let folder = std::env::temp_dir().join(format!("rival-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let (mut walks, mut expected, mut hits) = (String::new(), String::new(), 0);
    let stop = AtomicBool::new(false);
    let mut number = 0;
    for name in SCENES {
        let prepared = PreparedScene::new(&NamedScene::load(name).unwrap().scene).unwrap();
        for &cutoff_hz in &prepared.scene().sweep.cutoffs_hz {
            writeln!(walks, "{}", line(&prepared, cutoff_hz)).unwrap();
            let filter = prepared.scene().velocity.at(cutoff_hz);
            let found = walk(Engine::lanes(), &prepared, Numeric::F64, filter, 0.0, &stop).unwrap();
            for point in &found.points {
                let (b, k) = (point.damping_n_s_per_m, point.stiffness_n_per_m);
                writeln!(expected, "{number} {b} {k}").unwrap();
            }
            hits += found.hits;
            number += 1;
        }
    }
    let exact = compiled(&folder, &["-ffp-contract=off"]);
    let fused = compiled(&folder, &[]);
    assert_eq!(run(&exact, &walks), format!("{expected}hits {hits}\n"));
    println!("{number} walks, {hits} hits: the same boundaries");
    let simulator = simulator();
    let mut sweeps = 0;
    let mut sweep = |more: &[&str]| {
        sweeps += 1; // each sweep gets its own folder, because the command does not overwrite files
        let mut sweep = Command::new(&simulator);
        sweep.args(["sweep", "--repeat", "1"]).args(more);
        sweep.arg("--out").arg(folder.join(format!("sweep{sweeps}")));
        assert!(sweep.stdout(Stdio::null()).stderr(Stdio::null()).status().unwrap().success());
    };
    let mut best = [f64::INFINITY; 4];
    for _ in 0..ROUNDS {
        let c = |program: &Path| timed(|| drop(run(program, &walks)));
        let plain = timed(|| sweep(&["--plain"]));
        let round = [c(&exact), c(&fused), plain, timed(|| sweep(&[]))];
        for (best, time_s) in best.iter_mut().zip(round) {
            *best = best.min(time_s);
        }
    }
    fs::remove_dir_all(&folder).unwrap();
    let [exact, fused, ours, more] = best;
    println!("program,\"processor time, s\",\"times the sweep\"");
    for (name, time_s) in [
        ("cargo sim sweep --repeat 1 --plain", ours),
        ("cargo sim sweep --repeat 1, which walks to 1 um too", more),
        ("C, cc -O3 -march=native -ffp-contract=off", exact),
        ("C, cc -O3 -march=native", fused),
    ] {
        println!("\"{name}\",{time_s:.2},{:.2}", time_s / ours);
    }
}
