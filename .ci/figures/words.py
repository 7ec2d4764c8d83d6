"""What a stored row is in words, by the names that templates have for it: functions of the row."""

from .source import area_of as area, at_ideal, hertz, mega, number, row, significant

explains = lambda r: "yes" if r["explains"] else "no"
controller = lambda r: "with" if r["controller"] else "without"
change = lambda r: r["what"].replace(";", ",")
rank = lambda r: "" if r["rank"] == "0" else r["rank"]
is_settled = lambda r: "+" * (r["search_settled"] == "false")
estimated = lambda r: ", ".join(f"`{key}`" for name, key in r.items() if name.startswith("estimated.")) or "none"
area_if_ideal = lambda r: area(r) + ("*" if at_ideal([r]) else "")  # marked where it is at the ideal cutoff
limit_name = lambda r: f"{float(r['limit']) * 1e6:g} um" if r["limit_unit"] == "m" else f"felt, {float(r['limit']):g} dB"
area_at = lambda r: f"{area(r)} ({hertz(r)} Hz)"
ram_bytes_of = lambda r: cost(r, "ram_bytes")
tuning_hz = lambda r: f"{float(r['tuning']):.0f} Hz" if r["tuning_unit"] == "Hz" else ""
who_or_none = lambda r: who(r, "none")
area_3 = lambda r: area(r, lambda value: significant(value, 3))


def area_3_and_delay(r):
    """With its delay where it is one."""
    delay = 1e3 * float(r["delay_s"])
    return area_3(r) + (f" ({delay:.1f} ms)" if delay >= 0.05 else "")


def area_to_cap(r):
    cut = float(r["damping_max_mean_n_s_per_m"]) >= 4000
    return f(r, "area_n2_s_per_m2", 1e-6, 1) + (" (up to the cap of B)" if cut else "")


def times_range(r):
    """Of a change of the scene."""
    mean, low, high = (significant(r[key], 3) if r["times_the_area"] else "" for key in ("times_the_area", "times_low", "times_high"))
    return mean and f"{mean}{'?' if r['better'] == 'unsure' else ''} ({low} to {high})"


def who(r, free="free"):
    return "the worst of all" if r["push"] == "worst" else f"{r['arm'] or free}, {r['push']}"


def f(r, key, scale=1.0, digits=0, none="-"):
    return number(float(r[key]) * scale, digits) if r[key] else none


def tuned(r):
    def one(key, unit, edge):
        value = float(r[key])
        text = significant(value, 3) if value < 100 and r[unit] != "samples" else number(value, 0)
        return text + (f" {r[unit]}" if r[unit] != "1" else "") + ("*" if r[edge] == "true" else "")
    keys = [("tuning", "tuning_unit", "tuning_at_edge"), ("second", "second_unit", "second_at_edge")]
    return ", ".join(one(*names) for names in keys if r[names[0]])


def of_true_velocity(r):
    """Of the area that the true velocity has, %; an estimator that is told a force can have more."""
    return significant(100 * float(r["share_of_true_velocity"]), 2)


def percent(r):
    """The same as a whole number, where it is not too small for that."""
    share = 100 * float(r["share_of_true_velocity"])
    return f"{share:.{0 if share >= 9.95 else 1}f}"


def cost(r, what="cycles"):
    """Cycles as the tests hold them; a fixed tuning has its estimator's."""
    base = {"observer told in time": "observer", "first-order at 50 Hz": "first-order"}.get(r["estimator"], r["estimator"])
    return row("host-sim/data/estimator_cost.csv", estimator=base)[what]


def roughness(r):
    """Mean, smallest and largest of the repeats, mN."""
    mean, low, high = (f(r, f"roughness{end}_n", 1e3) for end in ("", "_low", "_high"))
    return f"{mean} ({low} to {high})" if r["roughness_n"] else "-"


def left(r):
    """Of the area, with a bandwidth that is wrong, %."""
    low, high = (f(r, f"left_when_bandwidth_{end}", 100) for end in ("low", "high"))
    return "-" if low == high == "-" else f"{low}, {high}"


def delay(r):
    hand, motor = (f(r, key, 1e3, 3) for key in ("delay_hand_s", "delay_motor_s"))
    return hand if hand == motor else f"{hand} / {motor}"


def winners(r):
    """Who is best by a criterion, and who is not told apart from those."""
    best, alike = ([name for key, name in r.items() if key.startswith(f"{part}.")] for part in ("best", "not_told_apart"))
    beside = ", ".join(name for name in alike if name not in best)
    return ", ".join(best) + (f"; not told apart: {beside}" if beside else "")


def response(r):
    """What a filter gets wrong, %, or why there is none."""
    return r["refused"] or (significant(100 * float(r["response_error"]), 2) if r["response_error"] else "-")


def missed(r):
    """What keeps a filter from doing just below its cutoffs."""
    return "refused" if r["refused_below"] else ", ".join(name for key, name in r.items() if key.startswith("missed_below."))


def ideal_range(r):
    """Of cutoffs, Hz."""
    low, high = (r[f"ideal_cutoff_range_hz.{end}"] for end in (0, 1))
    return (f"{low:g}" if low == high else f"{low:g} to {high:g}") + (" (the highest that was tried)" if high == 4000 else "")


def interval(r):
    """Of the area with 5 %, where it has one."""
    ends = [r[f"area_5_percent_{end}_n2_s_per_m2"] for end in ("low", "high")]
    return "" if ends == ["", ""] else " to ".join("?" if end == "" else mega(end) for end in ends)
