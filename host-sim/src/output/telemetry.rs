//! Figures of a board's telemetry.

use zwidth::{
    telemetry::{Flags, Record},
    units::Velocity,
};

use super::figure::{self, Figure, ReplayPlot, TelemetryPlot, TelemetryPoint};
use crate::{
    analysis::{replay::Replayed, telemetry::Capture},
    error::Error,
    scene::Scene,
};

/// The flags that the figure shows, and whether each flag is a problem.
const FACTS: [(&str, Flags, bool); 6] = [
    ("on", Flags::ON, false),
    ("armed", Flags::ARMED, false),
    ("contact", Flags::CONTACT, false),
    ("changing", Flags::CHANGING, false),
    ("saturated", Flags::SATURATED, true),
    ("fault", Flags::FAULT, true),
];

/// Draws position, velocity, force and flags over time. With the board's scene they are in SI units, otherwise in units
/// of the control core.
pub fn telemetry_figure(
    capture: &Capture,
    name: &str,
    scene: Option<&Scene>,
) -> Result<Figure, Error> {
    let records = capture.longest_run();
    // The records have equal distances in time. A larger distance means that records are missing.
    let usual = records.windows(2).map(|pair| pair[1].sample - pair[0].sample).min();
    let mut before = None;
    let points = records.iter().map(|record| {
        let distance = before.replace(record.sample).map(|before| record.sample - before);
        TelemetryPoint {
            after_gap: distance.zip(usual).is_some_and(|(distance, usual)| distance > usual),
            ..point(record, scene)
        }
    });
    let [time, position, velocity, force] = match scene {
        Some(scene) if scene.units.is_rotary() => {
            ["Time t [s]", "Angle [deg]", "Angular velocity [deg/s]", "Torque [N m]"]
        }
        Some(_) => ["Time t [s]", "Position x [mm]", "Velocity v [m/s]", "Force F [N]"],
        None => ["Sample n", "Position [counts]", "Velocity [counts/sample]", "Force [%]"],
    };
    let plot = TelemetryPlot {
        title: format!("Telemetry, {name}"),
        subtitle: format!(
            "{} records, {} dropped, fault codes {:?}; force that acts, into the wall positive",
            records.len(),
            capture.dropped,
            capture.faults()
        ),
        time_title: time.to_owned(),
        titles: [position, velocity, force].map(str::to_owned),
        facts: FACTS
            .map(|(name, flag, bad)| (name.to_owned(), u32::from(flag.bits()), bad))
            .to_vec(),
        points: points.collect(),
    };
    Ok(figure::telemetry(&plot)?)
}

/// Draws the velocity of an estimator and the velocity of the board, in SI units.
pub fn replay_figure(
    replayed: &Replayed,
    [title, file]: [&str; 2],
    scene: &Scene,
) -> Result<Figure, Error> {
    let (resolution_m, rate_hz) = (scene.encoder.resolution_m, scene.control.rate_hz);
    let [mm, speed] = ["mm", "m/s"].map(|unit| scene.units.written(unit).1);
    let both = replayed.board.iter().zip(&replayed.velocities);
    let points =
        replayed.positions.iter().zip(both).zip(0u32..).map(|((position, (board, here)), n)| {
            let velocity =
                |v: &Velocity| f64::from(v.bits()) / 65_536.0 * resolution_m * rate_hz * speed;
            let position = 1e3 * f64::from(position.counts()) * resolution_m * mm;
            [f64::from(n) / rate_hz, position, velocity(board), velocity(here)]
        });
    let titles = match scene.units.is_rotary() {
        true => ["Angle [deg]", "Angular velocity [deg/s]"],
        false => ["Position x [mm]", "Velocity v [m/s]"],
    };
    let plot = ReplayPlot {
        title: title.to_owned(),
        subtitle: format!("{file}: {} samples from sample {} on", replayed.len(), replayed.first),
        time_title: "Time t [s]".to_owned(),
        titles: titles.map(str::to_owned),
        names: ["the board's".to_owned(), title.split(',').next().unwrap_or(title).to_owned()],
        points: points.collect(),
    };
    Ok(figure::replay(&plot)?)
}

fn point(record: &Record, scene: Option<&Scene>) -> TelemetryPoint {
    let counts = f64::from(record.position.counts());
    let speed = f64::from(record.velocity.bits()) / 65_536.0;
    let force = f64::from(record.force.bits()) / f64::from(1u32 << 30);
    let sample = record.sample as f64;
    let (time, values) = match scene {
        None => (sample, [counts, speed, 100.0 * force]),
        Some(scene) => {
            let (resolution_m, rate_hz) = (scene.encoder.resolution_m, scene.control.rate_hz);
            let velocity_m_per_s = speed * resolution_m * rate_hz;
            let values =
                [1e3 * counts * resolution_m, velocity_m_per_s, force * scene.full_scale_n()];
            let [length, speed, newton] =
                ["mm", "m/s", "N"].map(|unit| scene.units.written(unit).1);
            let values = [values[0] * length, values[1] * speed, values[2] * newton];
            (sample / rate_hz, values)
        }
    };
    TelemetryPoint { time, values, after_gap: false, facts: u32::from(record.flags.bits()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;
    use zwidth::telemetry::Frame;

    #[test]
    fn the_axes_are_in_si_units_where_the_scene_is_known() {
        let frames = [0, 1].map(|sequence| Frame {
            sequence,
            record: Record { sample: u64::from(sequence), ..Record::default() },
        });
        let bytes: Vec<u8> = frames.iter().flat_map(|frame| frame.encode()).collect();
        let capture = Capture::decode(&bytes);
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        for (scene, title) in [(None, "Position [counts]"), (Some(&scene), "Velocity v [m/s]")] {
            let figure = telemetry_figure(&capture, "capture.bin", scene).unwrap();
            assert!(figure.svg().contains(title) && figure.svg().contains("saturated"));
        }
        assert!(telemetry_figure(&Capture::decode(&[]), "none", None).is_err());
    }
}
