"""Exact steps of a device with linear elements: augmented_step.csv and augmented_trajectory.csv.

The equations of motion come from element matrices, M q'' + C q' + K q = S F: each spring or damper between two
bodies adds k (e_i - e_j)(e_i - e_j)^T, one to the ground k e_i e_i^T. Bodies are device, mode (a mass behind a
spring and a damper) and arm (behind its grip, on the last body before it). An amplifier is F' = 2 pi f (command - F).
State: (q0, q0', q1, q1', .., F), positions from rest.

augmented_step.csv: phi (row by row) and gamma of one step, by mpmath's expm of [[A, b], [0, 0]] T, twice (Taylor,
Pade at more digits), agreeing to 50 digits relative to the largest entry of their row and column's scale.
augmented_trajectory.csv: the state after 60,000 steps of 0.1 ms from rest at 0.06 m with the force
((7919 n) mod 1001 - 500) / 256 N in step n (n = 0, 1, ..), at 60 digits.
The inputs are the doubles printed, taken exactly; 2 pi f too is exact, not rounded to a double.

Made with Python 3, mpmath 1.3.0. Deterministic: run `python3 augmented_step.py` in this directory (about a minute).
"""

import csv
from mpmath import mp, mpf, matrix, expm, nstr, pi, zeros, log10, ceil

DIGITS = 25  # printed
AGREE = 50

PAPER = (0.4160, 5.5195, 11.0626)
MODE = (0.15, 4.0, 6e4)
ARM = (1.2, 12.0, 250.0, 25.0, 1200.0)  # mass, damping, stiffness, grip damping, grip stiffness

# device (mass, damping, stiffness), mode, arm, amplifier Hz, T s
CASES = [
    (PAPER, None, None, 1000.0, 1e-4),
    (PAPER, MODE, None, None, 1e-4),
    (PAPER, None, ARM, None, 1e-4),
    (PAPER, MODE, None, 1000.0, 1e-4),
    (PAPER, MODE, ARM, None, 1e-4),
    (PAPER, MODE, ARM, 1000.0, 1e-4),
    (PAPER, MODE, ARM, 1000.0, 0.3e-4),
    (PAPER, MODE, ARM, 1000.0, 1e-3),
    # the pole far above and far below the rate; a time constant of 16 ns
    (PAPER, None, None, 1.0, 2e-5),
    (PAPER, None, None, 1e5, 1e-4),
    (PAPER, None, None, 1e7, 1e-3),
    (PAPER, MODE, ARM, 1e7, 1e-3),
    # undamped, with and without springs to the ground
    ((0.4, 0.0, 0.0), (0.2, 0.0, 1e5), None, None, 1e-4),
    ((0.4, 0.0, 1e4), (0.2, 0.0, 1e5), None, None, 1e-3),
    ((0.4, 0.0, 0.0), (0.2, 0.0, 1e5), (1.0, 0.0, 0.0, 0.0, 1e3), None, 1e-4),
    # a stiff transmission: 350 kHz; heavily damped: time constants below 1 us
    ((0.001, 0.0, 0.0), (0.001, 0.0, 1e9), None, None, 1e-3),
    ((0.4, 5.0, 10.0), (0.2, 1e6, 1e9), None, None, 1e-3),
    ((0.001, 1e6, 0.0), (0.001, 1e6, 0.0), None, 1e6, 1e-3),
    # corners of mass
    ((100.0, 1e-2, 1e-3), (0.001, 1e-3, 10.0), None, 500.0, 2e-5),
    ((0.001, 0.1, 0.0), (100.0, 1e3, 1e6), (10.0, 1e2, 1e3, 1e2, 1e5), 2e4, 1e-3),
    # the amplifier's pole on the mechanical one: no diagonal form
    ((1.0, 0.0, 0.0), None, (1.0, 2.0, 0.0, 2.0, 1.0), 0.5, 1e-3),
]
TRAJECTORIES = [0, 1, 2, 3, 4, 5]  # of CASES, and the device alone first
STEPS = 60_000
START_M = 0.06
REST_M = 0.0517


def system(device, mode, arm, amplifier):
    m, b, k = (mpf(v) for v in device)
    masses, springs = [m], [(0, None, b, k)]
    if mode:
        masses.append(mpf(mode[0]))
        springs.append((len(masses) - 1, len(masses) - 2, mpf(mode[1]), mpf(mode[2])))
    if arm:
        masses.append(mpf(arm[0]))
        springs.append((len(masses) - 1, len(masses) - 2, mpf(arm[3]), mpf(arm[4])))
        springs.append((len(masses) - 1, None, mpf(arm[1]), mpf(arm[2])))
    n = len(masses)
    damping, stiffness = zeros(n, n), zeros(n, n)
    for i, j, b, k in springs:
        e = zeros(n, 1)
        e[i] = 1
        if j is not None:
            e[j] = -1
        damping += b * e * e.T
        stiffness += k * e * e.T
    states = 2 * n + (1 if amplifier else 0)
    a, g = zeros(states, states), zeros(states, 1)
    for i in range(n):
        a[2 * i, 2 * i + 1] = 1
        for j in range(n):
            a[2 * i + 1, 2 * j] = -stiffness[i, j] / masses[i]
            a[2 * i + 1, 2 * j + 1] = -damping[i, j] / masses[i]
    if amplifier:
        pole = 2 * pi * mpf(amplifier)
        a[1, states - 1] = 1 / masses[0]
        a[states - 1, states - 1] = -pole
        g[states - 1] = pole
    else:
        g[1] = 1 / masses[0]
    return a, g


def step(case, method, digits):
    device, mode, arm, amplifier, dt = case
    mp.dps = digits
    a, _ = system(device, mode, arm, amplifier)
    size = max(abs(v) for v in a) * dt + 1
    mp.dps = digits + 2 * int(ceil(log10(size))) + 20
    a, g = system(device, mode, arm, amplifier)
    n = a.rows
    whole = zeros(n + 1, n + 1)
    for i in range(n):
        whole[i, n] = g[i] * mpf(dt)
        for j in range(n):
            whole[i, j] = a[i, j] * mpf(dt)
    e = expm(whole, method=method)
    return [[e[i, j] for j in range(n)] for i in range(n)], [e[i, n] for i in range(n)]


def text(values):
    return " ".join(nstr(v, DIGITS, min_fixed=0, max_fixed=0) for v in values)


def inputs(case):
    device, mode, arm, amplifier, dt = case
    cells = list(device) + list(mode or [""] * 3) + list(arm or [""] * 5) + [amplifier or "", dt]
    return [repr(float(v)) if v != "" else "" for v in cells]


HEADER = (
    "mass_kg,damping_n_s_per_m,stiffness_n_per_m,mode_mass_kg,mode_damping,mode_stiffness,arm_mass_kg,arm_damping,"
    "arm_stiffness,grip_damping,grip_stiffness,amplifier_hz,period_s"
).split(",")


def main():
    steps = []
    with open("augmented_step.csv", "w", newline="") as out:
        rows = csv.writer(out, lineterminator="\n")
        rows.writerow(HEADER + ["phi", "gamma"])
        for case in CASES:
            phi, gamma = step(case, "taylor", AGREE + 20)
            other, other_gamma = step(case, "pade", AGREE + 50)
            n = len(phi)
            largest = max(abs(v) for row in phi for v in row)
            for i in range(n):
                assert abs(gamma[i] - other_gamma[i]) <= max(map(abs, gamma)) * mpf(10) ** -AGREE, case
                for j in range(n):
                    assert abs(phi[i][j] - other[i][j]) <= largest * mpf(10) ** -AGREE, case
            steps.append((phi, gamma))
            rows.writerow(inputs(case) + [text(v for row in phi for v in row), text(gamma)])
    with open("augmented_trajectory.csv", "w", newline="") as out:
        rows = csv.writer(out, lineterminator="\n")
        rows.writerow(HEADER + ["state"])
        alone = (PAPER, None, None, None, 1e-4)
        for case in [alone] + [CASES[i] for i in TRAJECTORIES]:
            phi, gamma = step(case, "taylor", 80)
            mp.dps = 60
            n = len(phi)
            z = [mpf(0)] * n
            for body in range(n // 2):
                z[2 * body] = mpf(START_M) - mpf(REST_M)
            for i in range(STEPS):
                force = mpf((7919 * i) % 1001 - 500) / 256
                z = [mp.fdot(row, z) + g * force for row, g in zip(phi, gamma)]
            rows.writerow(inputs(case) + [text(z)])


if __name__ == "__main__":
    main()
