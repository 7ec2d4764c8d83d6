"""Who pushes, and what counts as stable."""

from . import block
from .devices import without
from .estimators import f, of, tuned
from .source import ROOT, area_of, m, measured, number, rows, rows_of, short, sim, significant, table


def limit_name(r):
    return f"{float(r['limit']) * 1e6:g} um" if r["limit_unit"] == "m" else f"felt, {float(r['limit']):g} dB"


def limit_area(r):
    return area_of(r) + ("*" if r["cutoff_hz"] and r["cutoff_hz"] == r["ideal_cutoff_hz"] else "")


@block
def criteria_limits():
    file = "limits-paper-1um.csv"
    shown = ["50", "100", "200", "500", "1000", "1500", "2000", "3000", "4000"]
    wanted = [("1.5e-05", "motor"), ("1.5e-05", "hand"), ("5e-06", "motor"), ("1e-06", "motor"), ("1e-06", "hand"),
              ("20", "motor"), ("10", "motor"), ("0", "motor")]
    body = []
    for limit, push in wanted:
        found = [r for r in rows_of(file, push=push, estimator="scene") if float(r["limit"]) == float(limit)]
        cells = [limit_area(next(r for r in found if float(r["cutoff_hz"]) == float(hz))) for hz in shown]
        low, high = (f"{float(found[0][f'ideal_{end}_hz']):g}" for end in ("low", "high"))
        body.append([f"{limit_name(found[0])}, {push}", *cells, low if low == high else f"{low} to {high}"])
    return table(["limit, push", *shown, "ideal range, Hz"], body)


@block
def criteria_levers(limit, push):
    """Area at the ideal cutoff, and that cutoff, by loop and what is between."""
    file, body = "levers-paper-1um.csv", []
    found = [r for r in rows_of(file, push=push) if abs(float(r["limit"]) / float(limit) - 1) < 1e-9]
    for of_loop, period in dict.fromkeys((r["loop"], r["output_period_samples"]) for r in found):
        in_row = [r for r in found if (r["loop"], r["output_period_samples"]) == (of_loop, period)]
        cells = []
        for between in ("as-is", "amplifier", "amplifier-and-mode"):
            of_it = [r for r in in_row if r["between"] == between and r["estimator"] == "scene"]
            best = next(r for r in of_it if r["cutoff_hz"] == r["ideal_cutoff_hz"])
            cells.append(f"{area_of(best)} ({float(best['cutoff_hz']):g} Hz)")
        told = next(r for r in in_row if r["estimator"] == "true-velocity")
        body.append([of_loop, period, *cells, area_of(told)])
    return table(["loop", "samples an output", "as it is", "amplifier of 1 kHz", "and a transmission of 150 Hz",
                  "true velocity"], body)


@block
def criteria_rates(limit, push):
    """Area at the ideal cutoff, and that cutoff, by encoder rate and output rate."""
    found = [r for r in rows_of("rates-paper-1um.csv", push=push, estimator="scene") if abs(float(r["limit"]) / float(limit) - 1) < 1e-9]
    encoders, outputs = (sorted({float(r[f"{which}_rate_hz"]) for r in found}) for which in ("encoder", "output"))

    def cell(encoder, output):
        of_it = [r for r in found if (float(r["encoder_rate_hz"]), float(r["output_rate_hz"])) == (encoder, output)]
        best = [r for r in of_it if r["cutoff_hz"] == r["ideal_cutoff_hz"]]
        if not best:
            return "none" if of_it else ""
        end = "*" if float(best[0]["cutoff_hz"]) == max(float(r["cutoff_hz"]) for r in of_it) else ""
        return f"{area_of(best[0])} ({float(best[0]['cutoff_hz']):g} Hz{end})"

    told = [r for r in rows_of("rates-paper-1um.csv", push=push, estimator="true-velocity") if abs(float(r["limit"]) / float(limit) - 1) < 1e-9]
    fastest = [next(r for r in told if float(r["output_rate_hz"]) == output and float(r["encoder_rate_hz"]) == encoders[-1]) for output in outputs]
    return table(["encoder rate, Hz", *[f"outputs at {number(output)} Hz" for output in outputs]],
                 [*[[number(encoder), *[cell(encoder, output) for output in outputs]] for encoder in encoders],
                  [f"true velocity, {number(encoders[-1])}", *map(area_of, fastest)]])


@block
def explained(encoder):
    body = []
    for r in rows(f"explain-paper-{encoder}.csv"):
        times = ""
        if r["times_the_area"]:
            mean, low, high = (significant(float(r[key]), 3) for key in ("times_the_area", "times_low", "times_high"))
            times = f"{mean}{'?' if r['better'] == 'unsure' else ''} ({low} to {high})"
        share = f"{100 * float(r['share_of_core']):.1f}" if r["share_of_core"] else ""
        body.append([r["rank"] if r["rank"] != "0" else "", r["what"].replace(";", ","), times,
                     area_of(r), short(float(r["scene_area_n2_s_per_m2"]) * 1e-6) if r["scene_area_n2_s_per_m2"] else "",
                     number(float(r["stiffness_peak_n_per_m"]), 0), number(float(r["stiffness_n_per_m"]), 0),
                     f"{1e3 * float(r['velocity_noise_m_per_s']):.2g}", share])
    b = float(rows(f"explain-paper-{encoder}.csv")[0]["damping_n_s_per_m"])
    return table(["rank", "change", "times the area", "area, 10^6 N^2 s/m^2", "by 15 um", "peak K, N/m", f"K at B = {b:g}, N/m",
                  "noise, mm/s", "of the core, %"], body)


@block
def criteria_people():
    """Largest K of a spring alone by rate of the output, of an estimated device, beside what people called clean."""
    told = (ROOT / "docs/data/choi-tan.toml").read_text()
    rates, body = {250: 160, 1000: 40, 5000: 8, 10_000: 4, 40_000: 1}, []
    for name, text in {"rigid, no lag": without(told, "amplifier"), "force lags by 1.6 ms (100 Hz)": told}.items():
        for criterion in ("quiet", "felt"):
            peaks = [sim(f"walk SCENE.toml --criterion {criterion}", text.replace("period = 160", f"period = {period}"))["stiffness_peak_n_per_m"]
                     for period in rates.values()]
            body.append([f"{name}, `{criterion}`", *(f"{1e-3 * peak:.3g}" for peak in peaks), significant(peaks[-1] / peaks[0], 2)])
    return table(["largest K, N/mm", *(f"output at {number(rate)} Hz" for rate in rates), "last over first"],
                 [["people, published", "0.325", "", "", "", "0.904", "2.8"], *body])


@block
def criteria_yardstick():
    file = "limits-paper-1um.csv"
    body = []
    for told in rows_of(file, push="motor", estimator="true-velocity"):
        own = [r for r in rows_of(file, push="motor", estimator="scene", limit=told["limit"], limit_unit=told["limit_unit"])
               if r["cutoff_hz"] == r["ideal_cutoff_hz"]]
        share = 100 * float(own[0]["share_of_true_velocity"])
        body.append([limit_name(told), area_of(own[0]), area_of(told), f"{share:.0f} %"])
    return table(["limit, motor", "ideal cutoff", "true velocity", "share"], body)


def three(key):
    return short(float(measured(f"host/criteria/{key}")))


def ends(key):
    low, high = three(f"{key}/low"), three(f"{key}/high")
    return low if low == high else f"{low} to {high}"


@block
def criteria_saturation():
    rows_ = [("10", "motor"), ("20", "motor"), ("100", "motor"), ("5.2", "hand"), ("10", "hand"), ("100", "hand")]
    return table(["limit of the command, who pushes", "four starts", "twin in `f64`", "independent program"],
                 [[f"{limit} V, {who}", ends(f"saturation/{limit}/{who}"), three(f"saturation/{limit}/{who}/twin"),
                   three(f"saturation/{limit}/{who}/independent")] for limit, who in rows_])


@block
def criteria_by_hand():
    body = []
    for name in ("butterworth", "kalman-3", "levant-explicit"):
        motor = f(of("paper-1um", name), "area_n2_s_per_m2", 1e-6, 1)
        body.append([f"`{name}`, {tuned(of('paper-1um', name))}", motor, ends(f"by_hand/{name}"), three(f"by_hand/{name}/twin"),
                     three(f"by_hand/{name}/independent")])
    return table(["estimator", "motor", "hand, four starts", "twin in `f64`", "independent program"], body)


@block
def criteria_felt():
    body = {}
    for encoder in ("1um", "2um"):
        for r in rows_of(f"felt-paper-{encoder}.csv", estimator="scene"):
            if r["cutoff_hz"] != r["ideal_cutoff_hz"]:
                continue
            who = "the worst of all" if r["push"] == "worst" else f"{r['arm'] or 'free'}, {r['push']}"
            key = (f"{encoder[0]} um", who)
            body.setdefault(key, {})[float(r["limit"])] = f"{area_of(r)} at {float(r['cutoff_hz']):g}"
    return table(["encoder", "arm, push", "12 dB more sensitive", "the model", "12 dB less sensitive"],
                 [[*key, *(cells[level] for level in (-12.0, 0.0, 12.0))] for key, cells in body.items()])


@block
def criteria_felt_design():
    body = []
    for encoder in ("1um", "2um"):
        found = {(r["arm"], r["push"], float(r["limit"])): r for r in rows_of(f"felt-designed-paper-{encoder}.csv", estimator="scene")}
        for arm, push in dict.fromkeys(key[:2] for key in found):
            who = "the worst of all" if push == "worst" else f"{arm or 'free'}, {push}"
            cells = []
            for level in (-12.0, 0.0, 12.0):
                low_pass = float(felt_best(encoder)[arm, push, level]["area_n2_s_per_m2"])
                own = float(found[arm, push, level]["area_n2_s_per_m2"])
                cells.append(f"{significant(own / 1e6, 3)} ({own / low_pass:.2f})")
            body.append([f"{encoder[0]} um", who, *cells])
    return table(["encoder", "arm, push", "12 dB more sensitive", "the model", "12 dB less sensitive"], body)


@block
def criteria_second():
    body = [[limit, *(m(f"host/criteria/levers/{key}/{which}", 0) for which in ("cells", "within")),
             f"{float(m(f'host/criteria/levers/{key}/worst_percent')):.1f} %"] for limit, key in [("1 um", "1um"), ("15 um", "15um")]]
    return table(["limit, motor", "loops", "within 3 %", "farthest off"], body)


@block
def criteria_resolution():
    body = []
    for text, level in [("12 dB less sensitive", 12), ("the model", 0), ("12 dB more sensitive", -12)]:
        cells = []
        for name in ("paper", "board"):
            um, hz, b = (float(measured(f"host/criteria/felt/{name}/{level}/{key}")) for key in ("um", "cutoff_hz", "damping"))
            cells.append(f"{significant(um, 2)} um ({hz:g} Hz, {b:g} N s/m)")
        body.append([text, *cells])
    return table(["who feels", "the paper's loop", "with the NUCLEO-F446RE's latency"], body)


@block
def criteria_held():
    told = [("RMS 5, 2, 1, 0.5 um, both encoders, nine cutoffs", "table_of_limits", "limits"),
            ("felt 0, 10, 20 dB, both encoders, eight cutoffs", "table_of_levels", "levels"),
            ("true velocity", "yardstick", "yardstick")]
    body = []
    for text, test, key in told:
        cells = m(f"host/criteria/{key}/cells")
        # of the yardstick every cell has to be
        within = cells if key == "yardstick" else m(f"host/criteria/{key}/within")
        body.append([f"{text} (`criteria::tables::{test}`)", cells, within])
    return table(["table", "cells above 10^6", "theirs within 3 % of the range of ours"], body)


@block
def criteria_beyond():
    body = [[cell, *[three(f"limits/{key}/{which}") for which in ("independent", "fixed_low", "fixed_high", "twin_low", "twin_high")]]
            for cell, key in [("2 um, 1500 Hz, below 5 um", "5um"), ("2 um, 500 Hz, below 1 um", "1um")]]
    return table(["cell, 10^6", "independent program", "ours, lowest", "highest", "our twin in `f64`, lowest", "highest"], body)


def felt_best(encoder):
    return {(r["arm"], r["push"], float(r["limit"])): r for r in rows(f"felt-paper-{encoder}.csv")
            if r["estimator"] == "scene" and r["cutoff_hz"] == r["ideal_cutoff_hz"]}


@block
def criteria_arms():
    file = "limits-paper-1um-arms.csv"
    body = {}
    for r in rows_of(file, estimator="scene"):
        if r["cutoff_hz"] == r["ideal_cutoff_hz"] and (r["limit_unit"] == "m" or float(r["limit"]) == 0):
            who = "the worst of all" if r["push"] == "worst" else f"{r['arm'] or 'none'}, {r['push']}"
            cell = f"{area_of(r)} at {float(r['cutoff_hz']):g}"
            body.setdefault(who, {})[limit_name(r)] = cell
    names = ["15 um", "1 um", "felt, 0 dB"]
    return table(["arm, push", *names], [[who, *(cells[name] for name in names)] for who, cells in body.items()])
