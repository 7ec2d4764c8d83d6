"""Who pushes, and what counts as stable."""

from . import block
from .devices import without
from .estimators import f, of, tuned
from .source import (
    ROOT, area_of, at_ideal, grouped, hertz, mega, number, rows, rows_of, short, significant, sim, table, value,
)

LIMITS = "limits-paper-1um.csv"


def limit_name(r):
    return f"{float(r['limit']) * 1e6:g} um" if r["limit_unit"] == "m" else f"felt, {float(r['limit']):g} dB"


def of_limit(name, limit, **wanted):
    return [r for r in rows_of(name, **wanted) if abs(float(r["limit"]) - float(limit)) <= 1e-9 * float(limit)]


def area_at(r):
    return f"{area_of(r)} ({hertz(r)} Hz)"


SHOWN_HZ = ["50", "100", "200", "500", "1000", "1500", "2000", "3000", "4000"]


@block("limit, push", *SHOWN_HZ, "ideal range, Hz")
def criteria_limits():
    for limit, push in [("1.5e-05", "motor"), ("1.5e-05", "hand"), ("5e-06", "motor"), ("1e-06", "motor"), ("1e-06", "hand"),
                        ("20", "motor"), ("10", "motor"), ("0", "motor")]:
        found = {hertz(r): r for r in of_limit(LIMITS, limit, push=push, estimator="scene")}
        first = found[SHOWN_HZ[0]]
        ends = dict.fromkeys(hertz(first, f"ideal_{end}_hz") for end in ("low", "high"))
        cells = (area_of(found[hz]) + ("*" if at_ideal([found[hz]]) else "") for hz in SHOWN_HZ)
        yield f"{limit_name(first)}, {push}", *cells, " to ".join(ends)


@block("loop", "samples an output", "as it is", "amplifier of 1 kHz", "and a transmission of 150 Hz", "true velocity")
def criteria_levers(limit, push):
    """Area at the ideal cutoff, and that cutoff, by loop and what is between."""
    for loop, found in grouped(of_limit("levers-paper-1um.csv", limit, push=push), "loop", "output_period_samples").items():
        best = {r["between"]: area_at(r) for r in at_ideal(found) if r["estimator"] == "scene"}
        yield (*loop, *(best[between] for between in ("as-is", "amplifier", "amplifier-and-mode")),
               area_of(next(r for r in found if r["estimator"] == "true-velocity")))


@block()
def criteria_rates(limit, push):
    """Area at the ideal cutoff, and that cutoff, by encoder rate and output rate."""
    by_rates, true_velocity = (
        grouped(of_limit("rates-paper-1um.csv", limit, push=push, estimator=name), "encoder_rate_hz", "output_rate_hz")
        for name in ("scene", "true-velocity"))
    encoders, outputs = (sorted(set(rates), key=float) for rates in zip(*by_rates))

    def cell(found):
        if not (best := at_ideal(found)):
            return "none" if found else ""
        highest = max(found, key=lambda r: float(r["cutoff_hz"]))
        return area_at(best[0]).replace(" Hz)", " Hz*)" if best[0] is highest else " Hz)")

    body = [[number(encoder), *(cell(by_rates.get((encoder, output), [])) for output in outputs)] for encoder in encoders]
    body.append([f"true velocity, {number(encoders[-1])}", *(area_of(true_velocity[encoders[-1], output][0]) for output in outputs)])
    return table(["encoder rate, Hz", *(f"outputs at {number(output)} Hz" for output in outputs)], body)


@block()
def explained(encoder):
    body = []
    for r in rows(f"explain-paper-{encoder}.csv"):
        mean, low, high = (significant(r[key], 3) if r["times_the_area"] else "" for key in ("times_the_area", "times_low", "times_high"))
        body.append(["" if r["rank"] == "0" else r["rank"], r["what"].replace(";", ","),
                     mean and f"{mean}{'?' if r['better'] == 'unsure' else ''} ({low} to {high})",
                     area_of(r), r["scene_area_n2_s_per_m2"] and short(float(r["scene_area_n2_s_per_m2"]) * 1e-6),
                     *(significant(float(r[key]) / 1e3, 3) for key in ("stiffness_peak_n_per_m", "stiffness_n_per_m")),
                     f"{1e3 * float(r['velocity_noise_m_per_s']):.2g}", f(r, "share_of_core", 100, 1, "")])
    b = hertz(rows(f"explain-paper-{encoder}.csv")[0], "damping_n_s_per_m")
    return table(["rank", "change", "times the area", "area, 10^6 N^2 s/m^2", "by 15 um", "peak K, kN/m", f"K at B = {b}, kN/m",
                  "noise, mm/s", "of the core, %"], body)


@block("largest K, N/mm", *(f"output at {rate} Hz" for rate in ("250", "1000", "5000", "10,000", "40,000")), "last over first")
def criteria_people():
    """Largest K of a spring alone by rate of the output, of an estimated device, beside what people called clean."""
    yield "people, published", "0.325", "", "", "", "0.904", "2.8"
    told = (ROOT / "docs/data/choi-tan.toml").read_text()
    for name, text in {"rigid, no lag": without(told, "amplifier"), "force lags by 1.6 ms (100 Hz)": told}.items():
        for criterion in ("quiet", "felt"):
            scenes = [text.replace("period = 160", f"period = {period}") for period in (160, 40, 8, 4, 1)]
            peaks = [sim(f"walk SCENE.toml --criterion {criterion}", scene)["stiffness_peak_n_per_m"] for scene in scenes]
            yield f"{name}, `{criterion}`", *(f"{1e-3 * peak:.3g}" for peak in peaks), significant(peaks[-1] / peaks[0], 2)


@block("limit, motor", "ideal cutoff", "true velocity", "share")
def criteria_yardstick():
    for told in rows_of(LIMITS, push="motor", estimator="true-velocity"):
        own = at_ideal(rows_of(LIMITS, push="motor", estimator="scene", limit=told["limit"], limit_unit=told["limit_unit"]))[0]
        yield limit_name(told), area_of(own), area_of(told), f"{100 * float(own['share_of_true_velocity']):.0f} %"


@block("estimator", "motor", "hand, four starts", "twin in `f64`", "independent program")
def criteria_by_hand():
    for name in ("butterworth", "kalman-3", "levant-explicit"):
        r = of("paper-1um", name)
        low, high, *others = (short(value(f"host/criteria/by_hand/{name}/{which}"))
                              for which in ("low", "high", "twin", "independent"))
        yield f"`{name}`, {tuned(r)}", f(r, "area_n2_s_per_m2", 1e-6, 1), f"{low} to {high}", *others


LEVELS = {-12: "12 dB more sensitive", 0: "the model", 12: "12 dB less sensitive"}


def felt(name):
    """What is felt at the ideal cutoff, by arm, push and level."""
    return {(r["arm"], r["push"], float(r["limit"])): r for r in at_ideal(rows_of(name, estimator="scene"))}


def who_feels(arm, push, free="free"):
    return "the worst of all" if push == "worst" else f"{arm or free}, {push}"


@block("encoder", "arm, push", *LEVELS.values())
def criteria_felt():
    for encoder in ("1um", "2um"):
        found = felt(f"felt-paper-{encoder}.csv")
        for who in dict.fromkeys(key[:2] for key in found):
            cells = [found[*who, level] for level in LEVELS]
            yield f"{encoder[0]} um", who_feels(*who), *(f"{area_of(r)} at {hertz(r)}" for r in cells)


@block("encoder", "arm, push", *LEVELS.values())
def criteria_felt_design():
    for encoder in ("1um", "2um"):
        designed = {(r["arm"], r["push"], float(r["limit"])): r for r in rows_of(f"felt-designed-paper-{encoder}.csv", estimator="scene")}
        low_pass = felt(f"felt-paper-{encoder}.csv")
        for who in dict.fromkeys(key[:2] for key in designed):
            areas = [[float(found[*who, level]["area_n2_s_per_m2"]) for found in (designed, low_pass)] for level in LEVELS]
            yield f"{encoder[0]} um", who_feels(*who), *(f"{mega(own)} ({own / other:.2f})" for own, other in areas)


@block("arm, push", "15 um", "1 um", "felt, 0 dB")
def criteria_arms():
    found = {(r["arm"], r["push"], limit_name(r)): r for r in at_ideal(rows_of("limits-paper-1um-arms.csv", estimator="scene"))}
    for who in dict.fromkeys(key[:2] for key in found):
        cells = [found[*who, limit] for limit in ("15 um", "1 um", "felt, 0 dB")]
        yield who_feels(*who, "none"), *(f"{area_of(r)} at {hertz(r)}" for r in cells)
