"""The passivity controller beside the plain wall."""

import functools

from . import block, slots, states
from .source import m, number, significant, sim, table


@block
def passivity_random():
    return table(
        ["of {} random scenes (mass, damping, resolution, full scale, period, latency, arm, wall)".format(m("host/passivity/ran")), "without the controller", "with it"],
        [["a contact gives more than the reserve", m("host/passivity/gave"), m("host/passivity/beyond")],
         ["most that one gives, in reserves", m("host/passivity/plain_highest", 3), m("host/passivity/highest", 3)],
         ["motion changes faster than the acceleration allows", "", m("host/passivity/faster")],
         ["outputs saturated, %", m("host/passivity/saturated_without", 3), m("host/passivity/saturated_with", 3)]],
        right=(1, 2))


@functools.cache
def told(scene):
    return sim(f"passivity {scene}")


@block
def passivity(scene):
    found = told(scene)
    body = []
    for row in found["rows"]:
        cut = ">" if row["capped_walks"] else ""
        name = "with" if row["controller"] else "without"
        for of, hits in (("without", row["at_boundary_without"]), ("with", row["at_boundary_with"])):
            if hits:
                body.append([f"{significant(1e6 * row['limit'], 3)} µm, {number(row['cutoff_hz'])} Hz", name, cut + significant(row["area_n2_s_per_m2"] / 1e6, 3),
                             of, significant(1e3 * hits["given_j"], 2), significant(100 * hits["withheld_fraction"], 2),
                             significant(1e6 * hits["rms_motion_m"], 2), significant(hits["roughness_n"], 2)])
    head = [f"`{scene}`, reserve {significant(1e3 * found['reserve_j'], 2)} mJ: limit, cutoff", "controller", "area, 10^6 N^2 s/m^2",
            "walls of the boundary", "most given, mJ", "withheld, %", "RMS, µm", "force above 100 Hz, N"]
    return table(head, body, right=(2, 4, 5, 6, 7))


def at(scene, limit, hz, controller):
    return next(r for r in told(scene)["rows"] if (r["limit"], r["cutoff_hz"], r["controller"]) == (limit, hz, controller))


def areas(scene, limit, hz):
    return [at(scene, limit, hz, controller)["area_n2_s_per_m2"] for controller in (False, True)]


def given(scene, limit, hz, controller):
    return at(scene, limit, hz, controller)["at_boundary_without"]["given_j"]


states(
    "docs/passivity.md",
    ("* **The area hardly grows**:",
     lambda: all(1.0 <= areas("paper-1um", 15e-6, hz)[1] / areas("paper-1um", 15e-6, hz)[0] < 1.1 for hz in (500, 1500))
     and all(abs(areas(scene, 1e-6, hz)[1] / areas(scene, 1e-6, hz)[0] - 1) < 0.05
             for scene in ("paper-1um", "nucleo-f446re") for hz in (500, 1500))),
    ("* **Walls at the edge hum less.**",
     lambda: all(at("paper-1um", 15e-6, hz, True)["at_boundary_without"]["roughness_n"]
                 < 0.6 * at("paper-1um", 15e-6, hz, False)["at_boundary_without"]["roughness_n"]
                 and at("paper-1um", 15e-6, hz, True)["at_boundary_without"]["withheld_fraction"] < 0.06 for hz in (500, 1500))),
    ("**In the paper's loop a contact gives about ten times less**",
     lambda: all(5 < given("paper-1um", limit, hz, False) / given("paper-1um", limit, hz, True) < 20 for limit in (15e-6, 1e-6) for hz in (500, 1500))),
)
slots("docs/passivity.md",
      ("An output in which it has to divide takes up to {} cycles from event to register, {} without.",
       lambda: m("elf/passivity/nucleo-f446re/10/register_most"), lambda: m("elf/period/nucleo-f446re/10/register_most")))
