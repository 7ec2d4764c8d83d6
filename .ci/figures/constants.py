"""Constants of the source that pages repeat."""

import re

from . import slots, states
from .firmware import device, scene_constant
from .source import constant, lit, number, power

def const(path, name, digits=None):
    return lambda: number(lit(path, rf"const {name}: \w+ = ([\d._e-]+)"), digits)


def soft(key, scale=1.0):
    return lambda: number(scale * lit("src/experiment/return_move.rs", rf"SOFT: Self = Self \{{[^}}]*\b{key}: ([\d.e-]+)"))


WIDTH = "src/velocity/butterworth.rs"


def low_cutoff():
    return power(lit(WIDTH, r"CUTOFF_MIN: f64 = ([\d.e-]+)"))


def low_cutoff_lsb():
    """DC sum of the coefficients at the lowest cutoff, in LSB."""
    return number(2**30 * (2 * 3.141592653589793 * lit(WIDTH, r"CUTOFF_MIN: f64 = ([\d.e-]+)")) ** 2, 0)


slots(
    "docs/theory.md",
    ("Accepted cutoffs are {} to {} of the rate, pre-warped to {} (", low_cutoff, const(WIDTH, "CUTOFF_MAX"), const(WIDTH, "PREWARPED_MAX")),
    ("(w = 2 pi fc T), has {} LSB left: rounding it to an integer shifts the -3 dB frequency by up to 1/(2 * {}).", low_cutoff_lsb, low_cutoff_lsb),
    ("second order below {} of the rate.", const(WIDTH, "SECOND_ORDER_BELOW")),
)
slots("docs/device.md", ("| cutoff | {} to {} of the sample rate", low_cutoff, const(WIDTH, "CUTOFF_MAX")))
slots(
    "docs/estimators.md",
    ("a cutoff's {} to {}, pre-warped {}; the tracking", low_cutoff, const(WIDTH, "CUTOFF_MAX"), const(WIDTH, "PREWARPED_MAX")),
    ("The limit is {} cycles, a quarter", const("tests/elf/estimator_cost.rs", "CYCLES_MAX")),
)
slots(
    "docs/extremes.md",
    ("| cutoffs | {} to {} of the rate, at 1", low_cutoff, const(WIDTH, "CUTOFF_MAX")),
    ("| cutoff below {} of the rate (", low_cutoff),
    ("| cutoff above {} of the rate |", const(WIDTH, "CUTOFF_MAX")),
)
slots("docs/scenes.md", ("nominal cutoffs of the study | {} to {} of the rate ({} if pre-warped)", low_cutoff, const(WIDTH, "CUTOFF_MAX"),
                         const(WIDTH, "PREWARPED_MAX")))
slots(
    "docs/batch.md",
    ("This is checked every {} samples in lanes, every {} in the core.", const("host-sim/loop/src/engine/scheduler.rs", "CHUNK_SAMPLES"),
     const("host-sim/loop/src/simulation/prepared.rs", "EARLY_CHECK_SAMPLES")),
    ("| counts from one sample to the next | 2^{} |", lambda: constant("host-sim/loop/src/engine/scheduler.rs", r"JUMP_MAX: f64 = \(1 << (\d+)\)")),
)
slots(
    "docs/firmware.md",
    ("a soft spring ({} N/m, {} N s/m, at most {} N) whose far end moves to the start at {} m/s, never", soft("stiffness_n_per_m"),
     soft("damping_n_s_per_m"), soft("force_n"), soft("speed_m_per_s")),
    ("within {} um of the start for {} ms; after {} s the experiment", soft("tolerance_m", 1e6),
     lambda: number(1e3 * lit("src/experiment/return_move.rs", r"REST_S: f64 = ([\d.]+)")), soft("timeout_s")),
    ("as it is certain: every {} ms the sum", const("src/experiment/hit_sequence.rs", "LOOK_MS")),
    ("counts, but is not limited. {} N and {} s are our guess for the paper's motor", device("continuous_force_n"), device("time_constant_s")),
    ("that rises by {} % of full scale per second, is held for {} s,", scene_constant("rise_percent_per_s"), scene_constant("hold_s")),
)
PERIOD = "src/period.rs"
slots(
    "docs/firmware.md",
    ("less a `render` without new settings ({} cycles) that the logger has kept waiting ({}), shared by the samples, less {} for"
     " the rest of", *[lambda name=name: f"{lit(PERIOD, rf'const {name}: u32 = ([0-9_]+)'):.0f}" for name in ("RENDER", "MASK", "GUARD")]),
)
slots(
    "docs/first-power-up.md",
    ("| `[return]` | {} m/s, {} N |", device("speed_m_per_s"), device("force_n")),
)
slots(
    "docs/faults.md",
    ("the estimate is late, by {} s at the lowest, {} Hz; over-speed is",
     lambda: f"{2**0.5 / (2 * 3.141592653589793 * 1e4 * lit(WIDTH, r'CUTOFF_MIN: f64 = ([0-9.e-]+)')):.1f}",
     lambda: number(1e4 * lit(WIDTH, r"CUTOFF_MIN: f64 = ([\d.e-]+)"))),
)
WALK = "tests/elf/walk.rs"


def long_walk(n):
    """A number of the grid of the long walk: K from, step; B from, step, cap; settle, window; then the start in mm."""
    test = constant(WALK, r"fn a_walk_of_60_points(?s:.*?)grid\(scene, ([^)]*)\)")
    numbers = [float(text.replace("_", "")) for text in re.findall(r"[\d._]+", test)]
    start = constant(WALK, r"fn a_walk_of_60_points(?s:.*?)start_position_m = ([\d.]+)")
    return lambda: number([*numbers, 1e3 * float(start)][n])


slots(
    "docs/firmware.md",
    ("start at {} mm, B from {} to {} N s/m in steps of {}, K from {} N/m in steps of {}, settle {} s, window {} s",
     *map(long_walk, (7, 2, 4, 3, 0, 1, 5, 6))),
)
CALIBRATION = "src/experiment/calibration.rs"
slots(
    "docs/tuning.md",
    ("the force rises while the handle moves ({} % of full scale on the paper's handle)", const(CALIBRATION, "LIFTING")),
    ("in simulation to {} % of full scale, with", const(CALIBRATION, "MEAN_OFF")),
)
FUZZED = "virtual-board/src/fuzz"
slots(
    "docs/virtual-board.md",
    ("sessions have some {} |", const(f"{FUZZED}/campaign.rs", "SESSION")),
    ("in its wall, and every {} cycles of sleep |", const(f"{FUZZED}/instants.rs", "SLEEP")),
    ("leads the handle there, -1 to 1, at {} m/s and holds", lambda: number(1e4 * lit("virtual-board/src/cli.rs", r"HAND_M: f64 = ([\d.e-]+)"))),
    ("| `wait SECONDS` | waits, up to {} s |", const("virtual-board/src/cli.rs", "WAIT_MAX_S")),
)
LIVE = "live/src"


def finger(key):
    return lambda: number(lit(f"{LIVE}/hub.rs", rf"Finger \{{[^}}]*\b{key}: ([\d.]+)"))


slots(
    "docs/live.md",
    ("a spring of {} N/m with a damper of {} N s/m and {} N at most.", finger("stiffness_n_per_m"), finger("damping_n_s_per_m"), finger("limit_n")),
    ("velocity and force in the last {} outputs, Hann", const(f"{LIVE}/server/picture.rs", "SPECTRUM_ROWS")),
    ("| phase plane | the last {} outputs |", const(f"{LIVE}/server/picture.rs", "PHASE_ROWS")),
    ("and its noise at {} mm/s from", lambda: number(1e3 * lit(f"{LIVE}/predicted.rs", r"const SPEED: f64 = ([\d.]+)"))),
    ("its rows, at most {}.", const(f"{LIVE}/server.rs", "ROWS_MAX")),
    ("does not answer for {} s |", lambda: constant(f"{LIVE}/seats.rs", r"ABSENT: Duration = Duration::from_secs\((\d+)\)")),
    ("Messages are at most {} bytes, pages at most {}.", lambda: constant(f"{LIVE}/access.rs", r"MESSAGE_MAX: usize = (\d+)"),
     const(f"{LIVE}/access.rs", "PAGES_MAX")),
)
slots(
    "docs/troubleshooting.md",
    ("friction above the return's force ({} N)", soft("force_n")),
    ("the motor cools down, up to {} of its time constants", const("src/experiment/duty.rs", "PATIENCE")),
)
slots(
    "docs/tuning.md",
    ("up to {} of the motor's time constants.", const("src/experiment/duty.rs", "PATIENCE")),
    ("force at full command, N; within a factor of {} of the device's", const("src/device.rs", "FULL_SCALE_FACTOR")),
)
slots(
    "docs/faults.md",
    ("for {} ms outside contact, and the count stayed within less than {}: dead", lambda: number(1e3 * lit("src/safety/plan.rs", r"PUSH_S: f64 = ([\d.]+)")),
     const("src/safety/plan.rs", "PUSH_COUNTS")),
    ("for at most {} s however often", const("src/experiment/calibration.rs", "LONGEST_S")),
    ("for at most {} ms did not move the count the right way", lambda: number(1e3 * lit("src/safety/plan.rs", r"SIGN_TEST_S: f64 = ([\d.]+)"))),
)
FUZZ = "tests/elf/fuzz.rs"
slots(
    "docs/virtual-board.md",
    ("types some {} commands on the NUCLEO. CI types {} on each board, and tries every {}th instant",
     lambda: constant(FUZZ, r"sessions\(NUCLEO_F446RE, \d+, (\d+)\)"), lambda: number(lit(FUZZ, r"sessions\(board, \d+, ([\d_]+)\)")),
     lambda: constant(FUZZ, r"fuzz::sweep\(&session\(board\), (\d+), ")),
)
slots("docs/telemetry.md", ("## Frame, layout version 1 {} bytes, no padding", const("src/telemetry.rs", "LEN")))
RECORD = "src/store/record.rs"


def layout(head, letters):
    return lambda: constant(RECORD, rf'const {head}: u32 = u32::from_le_bytes\(\*b"{letters}\\x0(\d)"\)')


slots(
    "docs/settings.md",
    ("layout version {} {} words of 32 bits, least", layout("HEAD", "ZWS"), const(RECORD, "RECORD_WORDS")),
    ('| 0 | "ZWS" and the version, {} |', layout("HEAD", "ZWS")),
    ('"ZWP" and the version {}, the sequence', layout("HEAD_FURTHER", "ZWP")),
)

def sizes():
    """Bytes of a sector and of a record, and what a save of further parameters takes."""
    sector = 1024 * lit("src/board/f4/flash.rs", r"SECTOR_BYTES: usize = (\d+) \* 1024")
    return sector, 4 * lit(RECORD, r"const RECORD_WORDS: usize = (\d+)")


def saves(records):
    return int(sizes()[0] // (records * sizes()[1]))


slots(
    "docs/settings.md",
    ("| saves that a sector takes | {}; {} with `biquad`", lambda: str(saves(1)), lambda: str(saves(2))),
    ("| saves before the flash wears out | {} million (10,000 erases", lambda: f"{int(2 * saves(1) / 10) / 10:.1f}"),
    ("words divide a record's {} bytes", lambda: number(sizes()[1])),
)
RATE = "src/safety/rate.rs"
slots(
    "docs/safety.md",
    ("And every {} outputs the samples", const(RATE, "OUTPUTS")),
    ("a difference of more than {} %, either way, is code 24.", lambda: number(100 / lit(RATE, r"PART: u32 = (\d+)"))),
    ("Memory that nothing may touch {} bytes between statics and stack are out of bounds", const("src/board/f4/stack_guard.rs", "BYTES")),
    ("| TIM8 | counts at 1 MHz up to {};", const("src/contract.rs", "OUTPUT_WATCHDOG_US")),
)
slots(
    "docs/faults.md",
    ("have drifted apart by more than {} % over {} outputs |", lambda: number(100 / lit(RATE, r"PART: u32 = (\d+)")), const(RATE, "OUTPUTS")),
    ("| always | {} outputs at most: two comparisons |", lambda: number(2 * lit(RATE, r"OUTPUTS: u8 = (\d+)"))),
)
SITUATION = "virtual-board/src/campaign/situation.rs"


def ready(key):
    return lit(SITUATION, rf'"{key} ([\d.]+)"')


def swing(name):
    return lit(SITUATION, rf"const {name}: f64 = ([\d.e-]+)")


slots(
    "docs/faults.md",
    ("on its way to a wall that is far, with a push of {} %;",
     lambda: number(100 * ready("push") / (lit("scenes/nucleo-f446re.toml", r"(?m)^gain_n_per_v = (\S+)")
                                           * lit("scenes/nucleo-f446re.toml", r"(?m)^limit_v = (\S+)")), 0)),
    ("a hand swings it inside a wall of {} kN/m, {} to {} mm deep, at {} Hz:", lambda: number(ready("k") / 1e3),
     *[lambda sign=sign: f"{1e3 * (swing('DEPTH_M') + sign * swing('SWING_M')):.1f}" for sign in (-1, 1)], lambda: number(swing("SWING_HZ"))),
)
STUDY = "scenes/paper-1um.toml"
states(
    "docs/start.md",
    ("For each of twelve cutoffs it follows the boundary of the stable walls four times, from starts a quarter of a count apart.",
     lambda: len(constant(STUDY, r"(?m)^cutoffs_hz = \[(.*)\]").split(",")) == 12
     and constant("host-sim/src/cli/sweep.rs", r"default_value_t = (\d+)[^\n]*\n\s+repeat: u32") == "4"),
)
