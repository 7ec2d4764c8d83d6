//! Cost of each optional element. A wall hit with only this element is compared with a hit of the plain scene. The
//! throughput counts samples.
#![allow(clippy::unwrap_used, reason = "a benchmark fails loudly")]

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use host_sim::{
    scene::NamedScene,
    simulation::prepared::{Numeric, PreparedScene, WallHit},
};
use zwidth::VelocitySettings;

const PAPER: &str = include_str!("../../scenes/paper-1um.toml");
const HIT: WallHit = WallHit {
    velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
    stiffness_n_per_m: 30_000.0,
    damping_n_s_per_m: 100.0,
    start_offset_counts: 0.0,
};
const SAMPLES: u64 = 60_000;

const AMPLIFIER: &str = "[amplifier]\nbandwidth_hz = 1500\n";
const MODE: &str = "[mode]\nmass_kg = 0.15\nstiffness_n_per_m = 6e4\ndamping_n_s_per_m = 4\n";
const BACKLASH: &str = "[backlash]\ngap_m = 1e-4\n";
const AMPLIFIER_ERROR: &str = "[amplifier_error]\ncubic = -0.1\n";
const ARM: &str = "[arm]\nmass_kg = 1.2\ndamping_n_s_per_m = 12\nstiffness_n_per_m = 20\nrest_position_m = 0.05\n\
                   grip_damping_n_s_per_m = 25\ngrip_stiffness_n_per_m = 1200\n";
const FRICTION: &str =
    "[friction]\ncoulomb_n = 0.1\nstatic_n = 0.15\nstribeck_speed_m_per_s = 0.01\n";
const COGGING: &str = "[cogging]\namplitude_n = 0.1\npitch_m = 0.004\nphase_rad = 0.3\n";
const TRAVEL: &str = "[travel]\nstop = \"rigid\"\nlow_m = -0.01\nhigh_m = 0.1\nrestitution = 0.5\n";
const ENCODER_ERROR: &str =
    "[encoder_error]\ncycle_m = 2e-5\nfirst_m = 3e-7\nsecond_m = 1e-7\nphase_rad = 0\n";
const ENCODER_NOISE: &str = "[encoder_noise]\nrms_m = 5e-7\nseed = 1\n";
const JITTER: &str = "[jitter]\npeak_s = 5e-6\nseed = 1\n";
const EULER: &str = "[integrator]\nmethod = \"semi-implicit-euler\"\nsteps_per_sample = 1\n";
const RK4: &str = "[integrator]\nmethod = \"rk4\"\nsteps_per_sample = 1\n";
const ADAPTIVE: &str = "[integrator]\nmethod = \"dormand-prince\"\nrelative_tolerance = 1e-8\n\
                        absolute_tolerance_m = 1e-12\n";

fn elements(c: &mut Criterion) {
    let mut group = c.benchmark_group("one wall hit with");
    group.throughput(Throughput::Elements(SAMPLES));
    group.sample_size(10);
    let cases: [(&str, &[&str]); 18] = [
        ("nothing", &[]),
        ("amplifier", &[AMPLIFIER]),
        ("amplifier error", &[AMPLIFIER_ERROR]),
        ("mode", &[MODE]),
        ("arm", &[ARM]),
        ("amplifier, mode, arm", &[AMPLIFIER, MODE, ARM]),
        ("encoder error", &[ENCODER_ERROR]),
        ("encoder noise", &[ENCODER_NOISE]),
        ("jitter", &[JITTER]),
        ("nothing, by Euler", &[EULER]),
        ("nothing, by RK4", &[RK4]),
        ("nothing, by Dormand-Prince", &[ADAPTIVE]),
        ("friction, by RK4", &[FRICTION, RK4]),
        ("cogging, by RK4", &[COGGING, RK4]),
        ("travel, by RK4", &[TRAVEL, RK4]),
        ("mode with backlash, by RK4", &[MODE, BACKLASH, RK4]),
        ("friction, by Dormand-Prince", &[FRICTION, ADAPTIVE]),
        (
            "everything, by Dormand-Prince",
            &[
                AMPLIFIER,
                MODE,
                ARM,
                FRICTION,
                COGGING,
                TRAVEL,
                ENCODER_ERROR,
                ENCODER_NOISE,
                JITTER,
                ADAPTIVE,
            ],
        ),
    ];
    for (name, tables) in cases {
        let text = format!("{PAPER}\n{}", tables.join("\n"));
        let scene = NamedScene::parse(name.into(), text, name).expect("valid").scene;
        let prepared = PreparedScene::new(&scene).expect("valid");
        group.bench_function(name, |bencher| {
            bencher
                .iter(|| prepared.hit(black_box(Numeric::Fixed), black_box(&HIT), |_| ()).unwrap());
        });
    }
    group.finish();
}

criterion_group!(benches, elements);
criterion_main!(benches);
