//! Sessions at random: what a person, a hand and the world may do next, mostly such that something happens.

use zwidth::period::PERIODS;

use super::{
    action::Action,
    answer::Activity,
    command::{COMMANDS, Form, name_of},
    flood::is_answered_once,
    run::Mind,
};

/// SplitMix64.
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        bits ^ (bits >> 31)
    }

    pub fn below(&mut self, end: u64) -> u64 {
        self.bits() % end
    }

    /// Below that.
    pub fn small(&mut self, end: u8) -> u8 {
        u8::try_from(self.below(end.into())).unwrap_or_default()
    }

    /// One of them; there has to be one.
    pub fn one<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[usize::try_from(self.below(all.len() as u64)).unwrap_or_default()]
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        *self.one(all)
    }

    /// Once in `n`.
    fn once_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }

    #[expect(clippy::cast_precision_loss, reason = "53 bits")]
    fn part(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Between two numbers, with at most four digits that count.
    fn between(&mut self, low: f64, high: f64) -> f64 {
        let value = low + (high - low) * self.part();
        format!("{value:.3e}").parse().unwrap_or(value)
    }
}

/// Numbers that are no wall's.
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

/// The next actions of a session.
pub fn next(random: &mut Random, mind: &Mind) -> Vec<Action> {
    if mind.replayed.is_some() && !random.once_in(12) {
        return vec![Action::Wait(5_200)];
    }
    if !mind.model.streaming && random.once_in(3) {
        return say("stream on");
    }
    if random.once_in(60) {
        return flood(random, mind);
    }
    if random.once_in(if mind.view.on { 4 } else { 14 }) {
        return world(random, mind);
    }
    if random.once_in(6) {
        return vec![Action::Say(any(random, mind))];
    }
    let view = mind.view;
    if mind.model.activity != Activity::Idle {
        return match random.below(12) {
            0..5 => vec![Action::Wait(random.below(2_000))],
            5 | 6 => say("stop"),
            7 => say("status"),
            8 => say("disarm"),
            _ => vec![Action::Say(several(random, mind, 6))],
        };
    }
    match (view.fault, view.on, view.armed) {
        (0, true, true) => armed(random, mind),
        (0, true, false) => match random.below(8) {
            0..4 => vec![Action::Wait(random.below(3_300))],
            4 => say("disarm"),
            _ => vec![Action::Say(useful(random, mind))],
        },
        (0, false, _) => off(random, mind),
        _ => faulted(random, mind),
    }
}

fn say(line: &str) -> Vec<Action> {
    vec![Action::Say(line.into())]
}

/// Armed, and idle.
fn armed(random: &mut Random, mind: &Mind) -> Vec<Action> {
    match random.below(16) {
        0..6 => vec![Action::Say(several(random, mind, 12))],
        6..9 => lead(random, mind),
        9 => vec![Action::Free, Action::Wait(random.below(600))],
        10 if mind.held => vec![Action::Free, Action::Wait(600)],
        10 => say("hit"),
        11 => vec![Action::Say(format!("calibrate {}", random.between(-12.0, 12.0)))],
        12 => say("unlock envelope"),
        13 if random.below(3) == 0 => {
            vec![Action::Say(format!("k 0\nb 0\npulses {}", random.between(-1.0, 1.0)))]
        }
        13 => say(random.of(&["walk", "zero", "save", "load", "disarm"])),
        14 => vec![Action::Wait(random.below(500))],
        _ => vec![Action::Say(any(random, mind))],
    }
}

/// Commands typed at once.
fn several(random: &mut Random, mind: &Mind, most: u64) -> String {
    let lines: Vec<String> = (0..1 + random.below(most)).map(|_| useful(random, mind)).collect();
    lines.join("\n")
}

/// Many lines at once, at any output period; `arm` now and then, so that the force is on for a part of them.
fn flood(random: &mut Random, mind: &Mind) -> Vec<Action> {
    let mut lines = vec!["zero".to_owned(), "unlock envelope".into()];
    for _ in 0..20 + random.below(150) {
        lines.push(match random.below(8) {
            0 => "get".into(),
            1 => "arm".into(),
            2 => "disarm".into(),
            3 | 4 => any(random, mind),
            _ => useful(random, mind),
        });
    }
    lines.retain(|line| is_answered_once(line));
    vec![Action::Flood(random.of(&PERIODS), lines.join("\n"))]
}

/// The hand leads the handle towards the wall, or anywhere.
fn lead(random: &mut Random, mind: &Mind) -> Vec<Action> {
    let target_m = match random.below(4) {
        0 => random.between(-0.03, 0.09),
        _ => mind.model.settings.wall_m.clamp(-0.03, 0.1) + random.between(-1e-3, 1.5e-3),
    };
    let way_m = target_m - f64::from(mind.view.position) * 1e-6;
    let speed = random.between(0.05, 0.6);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few thousand")]
    let samples = (way_m.abs() / speed * 1e4) as u64;
    vec![Action::Lead(speed.copysign(way_m), samples.min(4_000))]
}

fn off(random: &mut Random, mind: &Mind) -> Vec<Action> {
    let inside = mind.model.settings.inside(&mind.model.envelope).is_ok();
    let Mind { view, stop_open, .. } = mind;
    match random.below(10) {
        0 | 1 => vec![Action::Say(several(random, mind, 16))],
        2 => say(random.of(&["save", "load", "zero", "stream off", "unlock envelope"])),
        3 => {
            let line = random.of(&[
                "motor -",
                "motor +",
                "motor +",
                "encoder -",
                "encoder +",
                "encoder +",
            ]);
            say(line)
        }
        // with both of them round the board arms and pushes the other way
        _ if mind.model.settings.motor_reversed != mind.model.settings.encoder_reversed => {
            say(random.of(&["motor +", "motor -", "encoder +", "encoder -"]))
        }
        _ if *stop_open => vec![Action::Stop(false), Action::Wait(30)],
        _ if mind.supply_mv < 2_900 => {
            vec![Action::Supply(mind.model.board.supply_mv), Action::Wait(30)]
        }
        _ if !mind.model.streaming => say("stream on"),
        _ if !view.zeroed || random.once_in(6) => say("zero"),
        _ if mind.held && !random.once_in(4) => vec![Action::Free, Action::Wait(300)],
        _ if view.contact => vec![Action::Say(format!("wall {}", random.between(0.003, 0.02)))],
        _ if !inside && !view.unlocked && !random.once_in(6) => {
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

fn faulted(random: &mut Random, mind: &Mind) -> Vec<Action> {
    match random.below(8) {
        0 if mind.model.streaming => say("faults"),
        0 | 1 => vec![Action::Say(several(random, mind, 8))],
        2 => say(random.of(&["arm", "zero", "unlock envelope", "clear"])),
        _ if mind.stop_open => vec![Action::Stop(false), Action::Wait(random.below(40))],
        _ if mind.supply_mv < 2_900 => {
            vec![Action::Supply(mind.model.board.supply_mv), Action::Wait(random.below(40))]
        }
        _ => say("clear"),
    }
}

/// The world: switches, supply, resets, the hand, at any cycle, with or without a command under way.
fn world(random: &mut Random, mind: &Mind) -> Vec<Action> {
    let mut actions = Vec::new();
    if random.once_in(3) {
        let line = useful(random, mind);
        if !line.starts_with("save") {
            actions.push(Action::Type(line));
        }
    }
    actions.push(Action::Cycles(random.below(18_000 * 12)));
    let good = mind.model.board.supply_mv;
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
        7 if mind.sees() && mind.model.activity == Activity::Idle => {
            actions.extend([
                Action::Jump(random.between(-1.6e-3, 1.6e-3)),
                Action::Wait(random.below(60)),
            ]);
        }
        8 => actions.extend([Action::Hold, Action::Wait(random.below(600))]),
        9 => actions
            .extend([Action::Lead(random.between(-1.3, 1.3), random.below(400)), Action::Hold]),
        _ => actions.push(Action::Free),
    }
    actions
}

/// A command with a value that may well be taken.
fn useful(random: &mut Random, mind: &Mind) -> String {
    let settings = &mind.model.settings;
    let [cutoff_hz, k, b] = mind.model.envelope.near(
        usize::try_from(random.below(1_000)).unwrap_or_default(),
        random.of(&[0.1, 0.4, 0.9, 1.0, 1.0, 1.001, 1.5]),
    );
    let near = |random: &mut Random| settings.wall_m + random.between(-2e-3, 2e-3);
    match random.below(24) {
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
                "kalman-3"
            ])
        ),
        11 | 12 => format!("wall {}", random.between(0.002, 0.03)),
        13 => format!("wall {}", near(random)),
        14 => format!("push {}", random.between(-3.0, 6.2)),
        15 => format!("start {}", random.between(-0.045, 0.02)),
        16 => format!("settle {}", random.between(0.0, 0.3)),
        17 => format!("rms {}", random.between(0.0, 1e-4)),
        18 => {
            let (name, _) = random.of(&super::settings::GRID);
            format!("{name} {}", random.between(0.0, 5_000.0))
        }
        19 => format!("fullscale {}", random.of(&[5.906, 5.5, 6.1, 1.9, 17.0, 18.0])),
        20 => random.of(&["faults", "help", "version", "get"]).into(),
        21 => "get".into(),
        _ => "status".into(),
    }
}

/// Any line: a command with or without what it needs, numbers that are none, garbage.
fn any(random: &mut Random, mind: &Mind) -> String {
    if random.once_in(6) {
        let length = 1 + random.below(20);
        return format!("#{}", (0..length).map(|_| random.of(&PIECES)).collect::<String>());
    }
    let (usage, form) = random.of(&COMMANDS);
    // Without frames nobody knows how arming goes on.
    let name = match name_of(usage) {
        "arm" if !mind.sees() => "status",
        // It has a test of its own: lines of parts that no model knows.
        "selftest" => "get",
        "stream" if mind.view.on || mind.view.fault != 0 => "get",
        name => name,
    };
    let word = match form {
        Form::Nothing => return name.to_owned(),
        Form::Number if name == "period" => random.of(&["10", "1e1", "3", "0", "-1", "1.5", "11"]),
        // A promise would be broken by what the session does next: the fault has a test of its own.
        Form::Number if name == "alive" => random.of(&["0", "-1", "19", "1e5", "x"]),
        Form::Number => random.of(&ODD),
        Form::Words(words) if random.once_in(8) => {
            random.of(&["", "+", "off", "envelope", words[0]])
        }
        Form::Words(words) => random.of(words),
        Form::Estimator => random.of(&["", "none", "difference", "butterworth"]),
        Form::Design => random.of(&["", "none", "quiet-2", "a_b", "0123456789abcdefg"]),
    };
    match random.below(12) {
        0 => name.to_owned(),
        1 => format!("{name} {word} {word}"),
        2 => format!("  {}\t {word} ", name.to_uppercase()),
        _ => format!("{name} {word}"),
    }
}
