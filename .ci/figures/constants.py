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
     const("host-sim/loop/src/simulation/prepared/run.rs", "EARLY_CHECK_SAMPLES")),
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
    ("leads the handle there, -1 to 1, at {} m/s and holds", lambda: number(1e4 * lit("virtual-board/src/cli/typed.rs", r"HAND_M: f64 = ([\d.e-]+)"))),
    ("| `wait SECONDS` | waits, up to {} s |", const("virtual-board/src/cli/typed.rs", "WAIT_MAX_S")),
)
LIVE = "live/src"


def finger(key):
    return lambda: number(lit(f"{LIVE}/hub.rs", rf"Finger \{{[^}}]*\b{key}: ([\d.]+)"))


slots(
    "docs/live.md",
    ("a spring of {} N/m with a damper of {} N s/m and {} N at most.", finger("stiffness_n_per_m"), finger("damping_n_s_per_m"), finger("limit_n")),
    ("velocity and force in the last {} outputs, Hann", const(f"{LIVE}/picture.rs", "SPECTRUM_ROWS")),
    ("| phase plane | the last {} outputs |", const(f"{LIVE}/picture.rs", "PHASE_ROWS")),
    ("and its noise at {} mm/s of the handle", lambda: number(1e3 * lit(f"{LIVE}/predicted.rs", r"const SPEED: f64 = ([\d.]+)"))),
    ("its rows, at most {}.", const(f"{LIVE}/server.rs", "ROWS_MAX")),
    ("has its [promise](tuning.md#commands), `alive {}`, and takes the force away by itself: fault 34, within {} ms and",
     const(f"{LIVE}/hub.rs", "PROMISE_MS"), const(f"{LIVE}/hub.rs", "PROMISE_MS")),
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
    ("for {} ms outside contact, and the count stayed within less than {}, or moved", lambda: number(1e3 * lit("src/safety/plan.rs", r"PUSH_S: f64 = ([\d.]+)")),
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


def further_layout():
    return constant(RECORD, r'const HEAD_FURTHER: u32 = u32::from_le_bytes\(\*b"ZWP\\x0(\d)"\)')


slots(
    "docs/settings.md",
    ("layout version {} {} words of 32 bits, least", const(RECORD, "LAYOUT"), const(RECORD, "RECORD_WORDS")),
    ('| 0 | "ZWS" and the version, {} |', const(RECORD, "LAYOUT")),
    ('"ZWP" and the version {}, the sequence', further_layout),
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
    ("And every {} outputs the samples", const(RATE, "BLOCK")),
    ("a difference of more than {} %, either way, is code 24.", lambda: number(100 / lit(RATE, r"PART: u32 = (\d+)"))),
    ("Memory that nothing may touch {} bytes between statics and stack are out of bounds", const("src/board/f4/stack_guard.rs", "BYTES")),
    ("| TIM8 | counts at 1 MHz up to {};", const("src/period.rs", "OUTPUT_WATCHDOG_US")),
)


def rate(name):
    return lit(RATE, rf"const {name}: \w+ = (\d+)")


slots(
    "docs/faults.md",
    ("have drifted apart by more than {} % over the last {} outputs |", lambda: number(100 / lit(RATE, r"PART: u32 = (\d+)")),
     lambda: number(rate("BLOCK") * rate("BLOCKS"))),
    ("| always | {} outputs at most |", lambda: number(rate("BLOCK") * (rate("BLOCKS") + 1))),
)
SITUATION = "virtual-board/src/campaign/situation.rs"


def ready(key):
    return lit(SITUATION, rf'"{key} ([\d.]+)"')


def situation(name):
    return lit(SITUATION, rf"const {name}: f64 = ([\d.e-]+);")


slots(
    "docs/faults.md",
    ("on its way to a wall that is far, with a push of {} %;",
     lambda: number(100 * situation("PUSH_N") / (lit("scenes/nucleo-f446re.toml", r"(?m)^gain_n_per_v = (\S+)")
                                           * lit("scenes/nucleo-f446re.toml", r"(?m)^limit_v = (\S+)")), 0)),
    ("a hand swings it inside a wall of {} kN/m, {} to {} mm deep, at {} Hz:", lambda: number(ready("k") / 1e3),
     *[lambda sign=sign: f"{1e3 * (situation('DEPTH_M') + sign * situation('SWING_M')):.1f}" for sign in (-1, 1)], lambda: number(situation("SWING_HZ"))),
)
STUDY = "scenes/paper-1um.toml"
states(
    "docs/start.md",
    ("For each of twelve cutoffs it follows the boundary of the stable walls four times, from starts a quarter of a count apart.",
     lambda: len(constant(STUDY, r"(?m)^cutoffs_hz = \[(.*)\]").split(",")) == 12
     and constant("host-sim/src/cli/sweep.rs", r"default_value_t = (\d+)[^\n]*\n\s+repeat: u32") == "4"),
)


# Times and limits of the safety
WATCHDOG = "src/board/f4/watchdog.rs"
PLAN = "src/safety/plan.rs"
# The independent watchdog's oscillator, kHz: least, nominal, most (data sheets of both chips).
LSI_KHZ = (17, 32, 47)


def reset_ms(name):
    nominal = lit(WATCHDOG, rf"const {name}: u16 = ([\d_]+)")
    return [nominal * LSI_KHZ[1] / khz for khz in reversed(LSI_KHZ)]


def reset_after(n):
    return lambda: f"{reset_ms('TIMEOUT_MS')[n]:.0f}"


def patience(n):
    return lambda: f"{reset_ms('PATIENT_MS')[n] / 1e3:.1f}"


def watchdog_ms():
    return number(lit("src/period.rs", r"OUTPUT_WATCHDOG_US: u32 = (\d+)") / 1e3)


def halt_ms():
    """The longest output period and two samples."""
    periods = constant("src/period.rs", r"PERIODS: \[u32; 4\] = \[([\d, ]+)\]").split(", ")
    return number((int(periods[-1]) + 2) / 10)


def part(name):
    """Part of full scale, %."""
    return lambda: number(100 / lit(PLAN, rf"const {name}: i32 = \(1 << Force::FRACTION_BITS\) / (\d+)"))


def plan_ms(name):
    return lambda: number(1e3 * lit(PLAN, rf"const {name}: f64 = ([\d.]+)"))


slots(
    "ARCHITECTURE.md",
    ("TIM8 and DMA2 drop enable {} ms after the last one, without the processor ([safety](docs/safety.md)); if the core's clock"
     " stops, the watchdog's reset, {} to {} ms", watchdog_ms, reset_after(0), reset_after(2)),
)
slots(
    "docs/firmware.md",
    ("reset after {} ms ({} to {} ms over", reset_after(1), reset_after(0), reset_after(2)),
    ("by a period: `sample` switches off, fault 20; by {} ms:", watchdog_ms),
    ("neither position nor velocity asks for | {} % of full scale in a millisecond |", part("SLEW")),
    ("| sign test; ramp; push without motion | {} ms; `ramp_in_s`; {} ms |", plan_ms("SIGN_TEST_S"), plan_ms("PUSH_S")),
    ("| stuck `render` | {} ms |", plan_ms("STUCK_S")),
    ("| halt by a debugger | {} ms |", halt_ms),
    ("| output watchdog | {} ms after the last output |", watchdog_ms),
    ("| rate of the samples | over {} outputs,", lambda: number(rate("BLOCK") * rate("BLOCKS"))),
    ("| return move | its speed over the last {} ms |", const("src/experiment/return_move.rs", "SPAN")),
    ("| early verdict of a walk | looked for each {} ms |", const("src/experiment/hit_sequence.rs", "LOOK_MS")),
    ("| a ring of {}, indexed by", const("src/sync/position_ring.rs", "LENGTH")),
    ("Nothing was compared with silicon. {} samples with commands", const("tests/elf/control/mod.rs", "SAMPLES")),
    ("push fades by at most {} % of full scale per ms;", part("SLEW")),
    ("moves the force by at most {} % of full scale per", part("SLEW")),
    ("A latency of {} samples allows", lambda: constant("src/board/nucleo_f446re.rs", r"LATENCY_SAMPLES: f64 = ([\d.]+)")),
)
slots(
    "docs/safety.md",
    ("| the output watchdog | TIM8, DMA2, TIM1 | clears MOE | {} ms after", watchdog_ms),
    ("all pins are inputs, and the pull-down holds enable low | {} to {} ms |", reset_after(0), reset_after(2)),
    ("manuals). {} ms are longer than two output periods", watchdog_ms),
    ("stop with it: the independent watchdog, {} to {} ms, and contact 2", reset_after(0), reset_after(2)),
)
VERDICT = "virtual-board/src/campaign/verdict.rs"
slots(
    "docs/faults.md",
    ("| 13 | push without motion | a force above {} % of full scale for", part("PUSH_FORCE")),
    ("| 21 | stuck render | no output for {} ms |", plan_ms("STUCK_S")),
    ("a dead encoder under a `push` of less than {} % of full scale", part("PUSH_FORCE")),
    ("The watchdog waits for {} s meanwhile (nominal; {} to {} s).", lambda: number(reset_ms("PATIENT_MS")[1] / 1e3), patience(0), patience(2)),
    ("runs on, and clears the bit {} ms after the last output.", watchdog_ms),
    ("* a halt shorter than {} ms, whatever", halt_ms),
    ("| no effect | the force was within {} % of full scale", lambda: number(100 * lit(VERDICT, r"const SAME: f64 = ([\d.]+)"))),
    ("| bounded | wrong by {} % of full scale at most, or for {} ms at most |", lambda: number(100 * lit(VERDICT, r"const SMALL: f64 = ([\d.]+)")),
     lambda: number(1e3 * lit(VERDICT, r"const SHORT_S: f64 = ([\d.e-]+)"))),
    ("what the table above allows, {} ms at least;", lambda: number(1e3 * lit("virtual-board/src/campaign/rows.rs", r"SOON_S: f64 = ([\d.e-]+)"))),
    ("let go at the fault, over {} mm at most.", lambda: number(1e3 * lit(VERDICT, r"const LET_GO_M: f64 = ([\d.e-]+)"))),
)
STATISTICS = "host-sim/loop/src/numerics/statistics.rs"


def best():
    return number(100 * lit(STATISTICS, r"AS_GOOD_AS_BEST: f64 = ([\d.]+)"))


slots("README.md", ("lowest whose mean area is at least {} % of the largest;", best))
slots("docs/start.md", ("whose mean area is at least {} % of the largest.", best))


# Records, frames, options
TELEMETRY = "src/telemetry.rs"
# Bytes of a CRC.
CHECK = 4


def frame(name):
    return lit(TELEMETRY, rf"const {name}: usize = (\d+)")


slots(
    "docs/telemetry.md",
    ("| 36 | 2 | length of the frame, {} to {} |", lambda: number(frame("LEN") + CHECK), lambda: number(frame("LEN_MAX"))),
    ("the outputs before the newest, oldest first, {} bytes each:", lambda: number(frame("EARLIER"))),
)
PREPARE = "host-sim/src/cli/prepare.rs"
slots(
    "docs/device-record.md",
    ("gives `starter.device`: no wall, off above {} m/s, a motor that", const(PREPARE, "STARTER_SPEED_M_PER_S")),
    ("stands a tenth of its force, a sign test of {} %.", lambda: number(100 * lit(PREPARE, r"STARTER_SIGN_TEST: f64 = ([\d.]+)"))),
)
states(
    "docs/device-record.md",
    ("some 1300 rows of envelope", lambda: 1300 < (lit("src/device/record.rs", r"WORDS_MAX: usize = (\d+)") - 100) / 3 < 1350),
    ("a motor that stands a tenth of its force", lambda: lit(PREPARE, r"STARTER_CONTINUOUS: f64 = ([\d.]+)") == 0.1),
)
PROMISE = "src/experiment/promise.rs"
slots(
    "docs/tuning.md",
    ("the promise of the next one within 200 ms ({} to {}):", const(PROMISE, "LEAST_MS"), const(PROMISE, "MOST_MS")),
    ("each change fades in by {} % of full scale per millisecond at most", part("SLEW")),
)
slots(
    "docs/virtual-board.md",
    ("the device's rest position, {} mm with the built-in scenes", lambda: number(1e3 * lit("scenes/nucleo-f446re.toml", r"(?m)^rest_position_m = (\S+)"))),
    ("how many in all, {} by default;", lambda: number(lit("virtual-board/src/fuzz/report.rs", r"default_value_t = ([\d_]+)[^\n]*\n\s+commands: u64"))),
    ("| `--rtt PORT` | of `serve`: the first of its three ports, {} by default;",
     lambda: constant("virtual-board/src/cli.rs", r"default_value_t = (\d+)\)\]\s+rtt")),
)
