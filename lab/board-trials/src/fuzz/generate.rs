//! Generates random sessions. A session has actions of a person at the console, of a hand at the handle, and of the
//! surroundings. Most actions have an effect on the board.

use zwidth::{
    console::usages,
    device::Device,
    experiment::{Activity, Report},
    period::PERIODS,
    safety::State,
    store::Stored,
};

use super::{action::Action, oracle::is_in_image, run::Checks};
use crate::random::Random;

/// Numbers that are not useful for a wall.
const ODD: [&str; 16] = [
    "0",
    "-0",
    "1e-9",
    "-1",
    "1e9",
    "-1e9",
    "1e22",
    "1e23",
    "nan",
    "0x10",
    "1,5",
    "123456789012345",
    "1e-22",
    "1234567890123456",
    ".",
    "5e-5",
];
const PIECES: [&str; 10] =
    ["#", "k", "\t", "\u{1b}[A", "é", "9e", "--", "hit;", "stop now", "\u{7f}"];

/// The state of the board, on which the choice of the next actions depends.
pub struct Situation<'a> {
    device: &'static Device<'static>,
    stored: &'a Stored,
    newest: &'a Report,
    checks: &'a Checks,
    good_mv: u32,
}

impl<'a> Situation<'a> {
    /// The state of a board that has just started.
    pub fn of(checks: &'a Checks, device: &'static Device<'static>, good_mv: u32) -> Option<Self> {
        let program = checks.oracle.program()?;
        let (stored, newest) = (program.stored(), program.newest.as_ref()?);
        Some(Self { device, stored, newest, checks, good_mv })
    }

    fn position_m(&self) -> f64 {
        f64::from(self.newest.record.position.counts()) * 1e-6
    }

    fn wall_m(&self) -> f64 {
        self.stored.settings.wall.position_m
    }

    fn useful(&self, random: &mut Random) -> String {
        useful(random, self.device, self.wall_m())
    }
}

/// Cutoff, K and B of each wall at the limit of the envelope.
fn border(device: &Device<'_>) -> Vec<[f64; 3]> {
    let walls = device.envelope.boundaries().flat_map(|(key, points)| {
        points.map(move |point| {
            [key.cutoff_hz, point.stiffness_high_n_per_m, point.damping_n_s_per_m]
        })
    });
    walls.collect()
}

pub fn next(random: &mut Random, seen: &Situation<'_>) -> Vec<Action> {
    if random.once_in(30) {
        return say("stream on");
    }
    let on = seen.newest.status.state.is_on();
    if random.once_in(60) {
        return burst(random, seen);
    }
    if random.once_in(if on { 4 } else { 14 }) {
        return world(random, seen);
    }
    if random.once_in(6) {
        return vec![Action::Say(any(random))];
    }
    if seen.newest.activity != Activity::None {
        return match random.below(12) {
            0..6 => vec![Action::Wait(random.below(5_000))],
            6 => say("stop"),
            7 => say("status"),
            8 => say("disarm"),
            _ => vec![Action::Say(several(random, seen, 6))],
        };
    }
    match seen.newest.status.state {
        State::Armed => armed(random, seen),
        State::SignTest | State::RampIn => match random.below(8) {
            0..4 => vec![Action::Wait(random.below(3_300))],
            4 => say("disarm"),
            _ => vec![Action::Say(seen.useful(random))],
        },
        State::Off => off(random, seen),
        State::Fault => faulted(random, seen),
    }
}

fn say(line: &str) -> Vec<Action> {
    vec![Action::Say(line.into())]
}

/// Actions while the board is armed and idle.
fn armed(random: &mut Random, seen: &Situation<'_>) -> Vec<Action> {
    match random.below(16) {
        0..6 => vec![Action::Say(several(random, seen, 12))],
        6..8 => lead(random, seen),
        9 => vec![Action::Free, Action::Wait(random.below(600))],
        8 | 10 => hit(random, seen),
        11 => vec![Action::Say(format!("calibrate {}", random.between(-12.0, 12.0)))],
        12 => say("unlock envelope"),
        13 if random.below(3) == 0 => {
            vec![Action::Say(format!("k 0\nb 0\npulses {}", random.between(-1.0, 1.0)))]
        }
        13 => say(random.of(&["walk", "zero", "save", "load", "disarm"])),
        14 => vec![Action::Wait(random.below(500))],
        _ => vec![Action::Say(any(random))],
    }
}

/// A complete hit, with a wall in front of the handle.
fn hit(random: &mut Random, seen: &Situation<'_>) -> Vec<Action> {
    let wall_m = seen.position_m() + random.between(0.001, 0.006);
    let any_n = random.between(-3.0, 6.2);
    let push_n = random.of(&[seen.stored.full_scale_n, 2.0, any_n]);
    let rms_m = 10f64.powf(random.between(-5.0, -2.5));
    let (criterion, pushes) = random.of(&[("rms", 1), ("quiet", 4)]);
    let line = format!(
        "unlock envelope\nwall {wall_m:.6}\ncriterion {criterion}\npush {push_n}\nsettle 0.02\nwindow 0.03\n\
         rms {rms_m:.2e}\nhit"
    );
    vec![Action::Free, Action::Wait(300), Action::Say(line), Action::Wait(6_000 * pushes)]
}

/// Up to `most` commands that are typed at once.
fn several(random: &mut Random, seen: &Situation<'_>, most: u64) -> String {
    let lines: Vec<String> = (0..1 + random.below(most)).map(|_| seen.useful(random)).collect();
    lines.join("\n")
}

/// Many lines without a pause, with the force off or on. If the force is off, the output period is often changed first.
fn burst(random: &mut Random, seen: &Situation<'_>) -> Vec<Action> {
    let mut actions = Vec::new();
    if random.once_in(2) {
        let period = format!("period {}", random.of(&PERIODS));
        actions.extend(
            ["stop\ndisarm", &period, "zero\nunlock envelope"].map(|text| Action::Say(text.into())),
        );
    }
    let line = |random: &mut Random| match random.below(8) {
        0 => "get".into(),
        1 => random.of(&["arm", "disarm"]).into(),
        2 | 3 => any(random),
        _ => seen.useful(random),
    };
    let lines: Vec<String> = (0..20 + random.below(60)).map(|_| line(random)).collect();
    // Lines with `save` are left out, since the time of writing flash varies.
    let lines: Vec<String> = lines.into_iter().filter(|line| !line.contains("save")).collect();
    actions.push(Action::Say(lines.join("\n")));
    actions
}

/// A hand moves the handle, often towards the wall.
fn lead(random: &mut Random, seen: &Situation<'_>) -> Vec<Action> {
    let target_m = match random.below(4) {
        0 => random.between(-0.03, 0.09),
        _ => seen.wall_m().clamp(-0.03, 0.1) + random.between(-1e-3, 1.5e-3),
    };
    let way_m = target_m - seen.position_m();
    let speed = random.between(0.05, 0.6);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few thousand")]
    let samples = (way_m.abs() / speed * 1e4) as u64;
    vec![Action::Lead(speed.copysign(way_m), samples.min(4_000))]
}

fn off(random: &mut Random, seen: &Situation<'_>) -> Vec<Action> {
    let (status, stored) = (&seen.newest.status, seen.stored);
    match random.below(12) {
        0 | 1 => vec![Action::Say(several(random, seen, 16))],
        2 => say(random.of(&["save", "load", "zero", "stream off", "unlock envelope"])),
        3 => {
            let signs = ["motor -", "motor +", "motor +", "encoder -", "encoder +", "encoder +"];
            say(random.of(&signs))
        }
        4 => vec![Action::Say(format!("period {}", random.of(&PERIODS)))],
        // If both signs are reversed, the board arms and pushes in the opposite direction.
        _ if stored.signs.motor_reversed != stored.signs.encoder_reversed => {
            say(random.of(&["motor +", "motor -", "encoder +", "encoder -"]))
        }
        _ if seen.checks.properties.stop_open => vec![Action::Stop(false), Action::Wait(30)],
        _ if seen.checks.properties.is_supply_low() => {
            vec![Action::Supply(seen.good_mv), Action::Wait(30)]
        }
        _ if !status.zeroed || random.once_in(6) => say("zero"),
        _ if seen.checks.held && !random.once_in(4) => vec![Action::Free, Action::Wait(300)],
        _ if status.contact => vec![Action::Say(format!("wall {}", random.between(0.003, 0.02)))],
        _ if !status.inputs.settings_valid && !status.unlocked && !random.once_in(6) => {
            say(random.of(&["unlock envelope", "k 500\nb 5\nestimator butterworth\ncutoff 1500"]))
        }
        _ if random.once_in(3) => {
            vec![Action::Say(format!(
                "settle {}\nwindow {}",
                random.between(0.01, 0.2),
                random.between(0.01, 0.2)
            ))]
        }
        _ => vec![Action::Say("arm".into()), Action::Wait(3_150)],
    }
}

fn faulted(random: &mut Random, seen: &Situation<'_>) -> Vec<Action> {
    match random.below(8) {
        0 => say("faults"),
        1 => vec![Action::Say(several(random, seen, 8))],
        2 => say(random.of(&["arm", "zero", "unlock envelope", "clear"])),
        _ if seen.checks.properties.stop_open => {
            vec![Action::Stop(false), Action::Wait(random.below(40))]
        }
        _ if seen.checks.properties.is_supply_low() => {
            vec![Action::Supply(seen.good_mv), Action::Wait(random.below(40))]
        }
        _ => say("clear"),
    }
}

/// Actions of the surroundings, such as switches, supply, resets and the hand. They come at any cycle, also during a
/// command.
fn world(random: &mut Random, seen: &Situation<'_>) -> Vec<Action> {
    let mut actions = Vec::new();
    if random.once_in(3) {
        let line = seen.useful(random);
        if !line.starts_with("save") {
            actions.push(Action::Type(line));
        }
    }
    actions.push(Action::Cycles(random.below(18_000 * 12)));
    let good = seen.good_mv;
    match random.below(12) {
        0 => actions.extend([Action::Stop(true), Action::Wait(random.below(40))]),
        1 => actions.extend([
            Action::Stop(true),
            Action::Cycles(random.below(20_000)),
            Action::Stop(false),
        ]),
        2 => actions.extend([Action::Supply(2_000), Action::Wait(random.below(40))]),
        3 => actions.extend([
            Action::Supply(2_000),
            Action::Cycles(random.below(20_000)),
            Action::Supply(good),
        ]),
        4 | 5 => actions.push(Action::Reset),
        6 => actions.push(Action::Power),
        7 => actions.extend([
            Action::Jump(random.between(-1.6e-3, 1.6e-3)),
            Action::Wait(random.below(60)),
        ]),
        8 => actions.extend([Action::Hold, Action::Wait(random.below(600))]),
        9 => actions
            .extend([Action::Lead(random.between(-1.3, 1.3), random.below(400)), Action::Hold]),
        _ => actions.push(Action::Free),
    }
    actions
}

/// A command with a value that the board may accept. `wall_m` is a position at which the wall may be.
pub fn useful(random: &mut Random, device: &Device<'_>, wall_m: f64) -> String {
    let walls = border(device);
    let pick = usize::try_from(random.below(1_000)).unwrap_or_default();
    let wall = pick.checked_rem(walls.len()).map(|pick| walls[pick]);
    let [cutoff_hz, high, b] = wall.unwrap_or([1500.0, 2000.0, 10.0]);
    let k = (high * random.of(&[0.1, 0.4, 0.9, 1.0, 1.0, 1.001, 1.5])).round();
    let near = |random: &mut Random| wall_m + random.between(-2e-3, 2e-3);
    match random.below(26) {
        0..3 => format!("k {k}"),
        3 => format!("k {}", random.between(0.0, 12_000.0)),
        4 | 5 => format!("b {b}"),
        6 => format!("b {}", random.between(0.0, 200.0)),
        7 => format!("cutoff {cutoff_hz}"),
        8 => format!(
            "cutoff {}",
            random.of(&[0.35, 0.3, 50.0, 333.3, 1500.0, 3800.0, 4990.0, 4991.0])
        ),
        9 => format!("tuning {}", random.between(10.0, 5000.0)),
        10 => format!(
            "estimator {}",
            random.of(&[
                "butterworth",
                "BUTTERWORTH",
                "first-order",
                "difference",
                "butterworth-prewarped",
                "first-order-prewarped",
                "none"
            ])
        ),
        11 | 12 => format!("wall {}", random.between(0.002, 0.03)),
        13 => format!("wall {}", near(random)),
        14 => format!("push {}", random.between(-3.0, 6.2)),
        15 => format!("start {}", random.between(-0.045, 0.02)),
        16 => format!("settle {}", random.between(0.0, 0.3)),
        17 => format!("rms {:.2e}", 10f64.powf(random.between(-5.0, -2.5))),
        18 => {
            let name = random.of(&["kstart", "kstep", "kmax", "bstart", "bstep", "bmax"]);
            format!("{name} {}", random.between(0.0, 5_000.0))
        }
        19 => format!("fullscale {}", random.of(&[5.906, 5.5, 6.1, 1.9, 17.0, 18.0])),
        20 => random.of(&["faults", "help", "version", "get"]).into(),
        21 => "get".into(),
        22 => format!("criterion {}", random.of(&["rms", "quiet"])),
        23 => format!("force_rms {:.2e}", 10f64.powf(random.between(-3.0, 1.0))),
        _ => "status".into(),
    }
}

/// Any line. It is a command with or without its values, has invalid numbers, or is random text.
pub fn any(random: &mut Random) -> String {
    if random.once_in(6) {
        let length = 1 + random.below(20);
        return format!("#{}", (0..length).map(|_| random.of(&PIECES)).collect::<String>());
    }
    let usages: Vec<&str> = usages().filter(|usage| is_in_image(usage)).collect();
    let usage = random.of(&usages);
    let (name, form) = usage.split_once(' ').unwrap_or((usage, ""));
    // A self-test needs two wires on the board.
    let name = if name == "selftest" { "get" } else { name };
    let words: Vec<&str> = form.split('|').collect();
    let word = match form {
        "" => return name.to_owned(),
        "SAMPLES" => random.of(&["1", "2", "5", "10", "1e1", "3", "0", "-1", "1.5", "11"]),
        // A long time would delay the session's next actions beyond the time that `alive` allows.
        "MS" => random.of(&["0", "0", "-1", "19", "1e5", "x", "500"]),
        "NAME" => random.of(&["", "none", "difference", "butterworth", "quiet-2", "a_b"]),
        _ if form.bytes().all(|byte| byte.is_ascii_uppercase() || byte == b'_') => random.of(&ODD),
        _ if random.once_in(8) => random.of(&["", "+", "off", "envelope"]),
        _ => random.of(&words),
    };
    match random.below(12) {
        0 => name.to_owned(),
        1 => format!("{name} {word} {word}"),
        2 => format!("  {}\t {word} ", name.to_uppercase()),
        _ => format!("{name} {word}"),
    }
}
