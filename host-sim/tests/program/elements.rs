//! A sweep of a scene with noise, jitter, friction and an integrator.

use std::process::Command;

const TABLES: &str = "
[encoder_noise]
rms_m = 5e-7
seed = 1
[jitter]
peak_s = 5e-6
seed = 1
[friction]
coulomb_n = 0.1
static_n = 0.15
stribeck_speed_m_per_s = 0.01
[integrator]
method = \"rk4\"
steps_per_sample = 2
";

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let text = format!("{}\n{TABLES}", include_str!("../../../scenes/paper-1um.toml"))
        .replace("settle_s = 4.0", "settle_s = 0.6")
        .replace("window_s = 2.0", "window_s = 0.2")
        .replace("stiffness_step_n_per_m = 2000", "stiffness_step_n_per_m = 8000")
        .replace("damping_step_n_s_per_m = 10", "damping_step_n_s_per_m = 100");
    let scene = folder.path().join("noisy.toml");
    std::fs::write(&scene, text).unwrap();
    let areas = |threads: &str| {
        let out = folder.path().join(threads);
        let status = Command::new(env!("CARGO_BIN_EXE_host-sim"))
            .arg("sweep")
            .arg(&scene)
            .args([
                "--plain",
                "--cutoffs",
                "50,200",
                "--repeat",
                "2",
                "--threads",
                threads,
                "--out",
            ])
            .arg(&out)
            .output()
            .unwrap();
        assert!(status.status.success(), "{}", String::from_utf8_lossy(&status.stderr));
        let file = |name: &str| {
            let direct = out.join(name);
            let nested = out.join("noisy").join(name);
            std::fs::read(if direct.exists() { direct } else { nested }).unwrap()
        };
        (file("areas.csv"), file("boundary.csv"))
    };
    assert_eq!(areas("1"), areas("2"));
}
