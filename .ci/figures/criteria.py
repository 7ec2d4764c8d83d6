"""Who pushes, and what counts as stable."""

from . import block
from .devices import without
from .source import ROOT, area_of, at_ideal, grouped, hertz, number, rows_of, significant, sim, table

def limit_name(r):
    return f"{float(r['limit']) * 1e6:g} um" if r["limit_unit"] == "m" else f"felt, {float(r['limit']):g} dB"


def of_limit(name, limit, **wanted):
    return [r for r in rows_of(name, **wanted) if abs(float(r["limit"]) - float(limit)) <= 1e-9 * float(limit)]


def area_at(r):
    return f"{area_of(r)} ({hertz(r)} Hz)"


def area_if_ideal(r):
    """Marked where it is at the ideal cutoff."""
    return area_of(r) + ("*" if at_ideal([r]) else "")


def times_range(r):
    """Of a change of the scene."""
    mean, low, high = (significant(r[key], 3) if r["times_the_area"] else "" for key in ("times_the_area", "times_low", "times_high"))
    return mean and f"{mean}{'?' if r['better'] == 'unsure' else ''} ({low} to {high})"


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


def who_feels(r, free="free"):
    return "the worst of all" if r["push"] == "worst" else f"{r['arm'] or free}, {r['push']}"
